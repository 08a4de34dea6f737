"""Addresses in a rig file: checked, and hidden wherever a rig is written down."""

import pytest
import yaml

from eldir.errors import InputError
from hardware.rig.addresses import without_addresses
from hardware.rig.configuration import Rig
from hardware.rig.template import virtual_rig

SECRET = "pw-Zk3"
ADDRESS = f"mailto://lab:{SECRET}@example.org"


@pytest.mark.parametrize(
    "entry",
    [
        f'notify: ["{ADDRESS}"]\n',
        f"notify:\n  - {ADDRESS}\n  - '{ADDRESS}'  # mine\n\nfan: {{interlocked: true}}\n",
        f'"notify": [\n  {ADDRESS},\n  {ADDRESS}\n]',
        f"notify: [{ADDRESS}]\n# before: {ADDRESS}\n  # or {ADDRESS}",
        f'notify:\n- "mailto://lab:pw-\\x5ak3@example.org"\n- {ADDRESS}\n',
    ],
)
@pytest.mark.parametrize("first", [False, True])
def test_a_log_gets_the_file_without_them(entry, first, tmp_path):
    base = virtual_rig().replace("fan: {interlocked: true}\n", "" if "fan:" in entry else "fan: null\n")
    text = f"{entry}\n{base}" if first else f"{base}\n{entry}"
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    rig = Rig.load(path)
    assert all(SECRET in address.get_secret_value() for address in rig.notify)
    kept = rig.source.decode()
    assert SECRET not in kept and "x5ak3" not in kept
    values, wanted = yaml.safe_load(kept), yaml.safe_load(text)
    assert values.pop("notify") == ["mailto://hidden"] * len(wanted.pop("notify"))
    assert values == wanted
    Rig.model_validate(yaml.safe_load(kept))
    assert len(Rig.model_validate(rig.model_dump(mode="json")).notify) == len(rig.notify)
    assert SECRET not in repr(rig) + str(rig.model_dump(mode="json"))


def test_a_file_without_addresses_is_kept_byte_for_byte(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(virtual_rig() + "# http://a.b/c\n")
    assert Rig.load(path).source == path.read_bytes()


NINE = f"[{', '.join(['a://b'] * 9)}]"


@pytest.mark.parametrize("wrong", [f"pw:{SECRET}", f"[{SECRET}]", "[5]", f"[a b://{SECRET}]", NINE])
def test_what_is_no_address_is_refused_without_showing_it(wrong, tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(f"{virtual_rig()}\nnotify: {wrong}\n")
    with pytest.raises(InputError, match=r"notify: .*expected") as told:
        Rig.load(path)
    assert SECRET not in str(told.value)


def test_no_text_is_made_of_a_file_that_is_none():
    assert without_addresses(b"- 1\n") == b"- 1\n"
