"""Addresses in a rig file: checked, and hidden wherever a rig is written down."""

import json

import pytest
import yaml
from hypothesis import event, given
from hypothesis import strategies as st

from eldir.errors import InputError
from eldir_hardware.log._salvage import valid_records
from eldir_hardware.log.reader import read_log
from eldir_hardware.rig._board_hints import read_board_hints
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import virtual_rig
from eldir_hardware.run.drive import drive_rig
from eldir_hardware.safety.compatibility import rig_digests, with_digests
from eldir_hardware.schedule import ActuationSchedule, Event
from eldir_hardware.vision.sources import CameraDevice
from tests.raised import raises

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
    Rig.from_json(yaml.safe_load(kept))
    assert len(Rig.from_json(rig.to_json()).notify) == len(rig.notify)
    assert SECRET not in repr(rig) + str(rig.to_json())


TOKEN = "pwZk3x5qQ7"
KINDS = st.sampled_from(["tgram", "mailto", "json", "x-y.z+1"])
ENDS = st.sampled_from(["\n", "\r\n"])
REMARKS = st.lists(
    st.sampled_from([f"was {{}}://{TOKEN}/1", f"{TOKEN}", f"{{}}: //lab:{TOKEN}@h", f'"{{}}://{TOKEN}', "é"]),
    max_size=4,
)
ENTRIES = st.sampled_from([
    "notify: [ {0},{0} ]", "notify: [\n\t {0},\n  {0}  ]", 'notify:\n- "{0}"', "'notify':\n      - '{0}'",
    "? notify\n: - {0}", "notify: !!seq [{0}]", "notify:\n  - >-\n    {0}\n  - |-\n     {0}",
    'notify: ["{0}", "{1}"]', 'notify:\n  - "{2}\\\n    {3}"', "",
])  # fmt: skip


@given(
    entry=ENTRIES, kind=KINDS, remarks=REMARKS, end=ENDS, mark=st.booleans(), flow=st.booleans(),
    first=st.booleans(), document=st.booleans(), data=st.data(),
)  # fmt: skip
def test_no_text_of_a_rig_file_brings_a_token_into_a_log(
    entry, kind, remarks, end, mark, flow, first, document, data, tmp_path_factory
):
    """Comments, styles, escapes, folded scalars, line ends, a byte order mark, and one flow mapping."""
    folder = tmp_path_factory.mktemp("rig")
    address = f"{kind}://lab:{TOKEN}@h/"
    escaped = "".join(f"\\x{ord(c):02x}" for c in address)
    entry = entry.format(address, escaped, address[:12], address[12:])
    base = virtual_rig().replace("camera:", "# camera:")
    if flow:
        base = json.dumps(yaml.safe_load(base))[:-1] + ", \n"
        lines = [base, *(entry.splitlines() if entry.startswith("notify: [") else [])]
        lines += ["}"]
    else:
        lines = [entry, base] if first else [base, entry]
        lines = ["---", *lines] if document else lines
    for remark in remarks:
        comment = "# " + remark.format(kind)
        where = data.draw(st.integers(0, len(lines)), label="where")
        lines.insert(where, comment)
    text = "\n".join(lines).replace("\n", end)
    path = folder / "rig.yaml"
    path.write_bytes((b"\xef\xbb\xbf" if mark else b"") + text.encode())
    try:
        rig = Rig.load(path)
    except InputError as error:
        assert TOKEN not in str(error)
        return
    event("loaded")
    assert TOKEN not in rig.source.decode() and escaped not in rig.source.decode()
    logged = folder / "logged.yaml"
    logged.write_bytes(rig.source)
    again = Rig.load(logged)
    assert (again.source, again.digest) == (rig.source, rig.digest)
    assert rig_digests(again) == rig_digests(rig) and len(again.notify) == len(rig.notify)
    assert again.model_dump(exclude={"notify"}) == rig.model_dump(exclude={"notify"})
    assert read_board_hints(logged).name == rig.name


def test_no_byte_of_a_log_has_a_token_from_comments_or_a_camera(tmp_path):
    text = virtual_rig().replace("camera:", f"# notify: tgram://{TOKEN}/1\n# camera:") + f"# was {TOKEN}\n"
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    rig = Rig.load(path)
    pulse = (Event(0.0, 0, "front", 1, True), Event(0.5, 0, "front", 1, False))
    schedule = with_digests(
        ActuationSchedule(20.0, events=pulse, cycles=1, conditioning_cycles=0, springs=(7,)), rig
    )
    drive_rig(schedule, rig, path, tmp_path / "log.mcap")
    assert read_log(tmp_path / "log.mcap").attachments["rig.yaml"] == rig.source
    for record in valid_records((tmp_path / "log.mcap").read_bytes()):
        assert TOKEN not in repr(record)
    assert TOKEN.encode() not in (tmp_path / "log.mcap").read_bytes()


def test_a_log_gets_no_password_of_a_camera(tmp_path):
    values = yaml.safe_load(virtual_rig())
    device = f"rtsp://lab:{TOKEN}@10.0.0.7:554/live"
    values |= {"kind": "real", "camera": {"kind": "live", "device": device, "tags": "tags.json"}}
    values["board"]["port"] = "/dev/ttyUSB0"
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(values))
    rig = Rig.load(path)
    assert rig.camera.device == device
    assert b"rtsp://hidden@10.0.0.7:554/live" in rig.source and TOKEN.encode() not in rig.source
    path.write_text(yaml.safe_dump(values | {"camera": values["camera"] | {"device": f"x{device}"}}))
    with pytest.raises(
        InputError, match=r"a camera is camera:0, .* rtsp://\.\.\., not xrtsp://hidden"
    ) as told:
        Rig.load(path)
    assert TOKEN not in str(told.value)


NINE = f"[{', '.join(['a://b'] * 9)}]"


@pytest.mark.parametrize("wrong", [f"pw:{SECRET}", f"[{SECRET}]", "[5]", f"[a b://{SECRET}]", NINE])
def test_what_is_no_address_is_refused_without_showing_it(wrong, tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(f"{virtual_rig()}\nnotify: {wrong}\n")
    with pytest.raises(InputError, match=r"notify: .*expected") as told:
        Rig.load(path)
    assert SECRET not in str(told.value)


def test_a_camera_that_gives_no_picture_is_named_without_its_password():
    with raises(InputError, "camera.no-picture", match=r"http://hidden@127\.0\.0\.1:9/video") as told:
        next(CameraDevice(f"http://lab:{SECRET}@127.0.0.1:9/video", 1.0).frames())
    assert SECRET not in str(told.value)


@pytest.mark.parametrize(
    "text",
    [
        ADDRESS,
        f"- {ADDRESS}",
        f"format: {ADDRESS}",
        f"{virtual_rig()}\n{ADDRESS}: 1\n",
        f"{virtual_rig()}\nnotify: {{lab:{SECRET}@h: 1, lab:{SECRET}@h: 2}}\n",
        f"{virtual_rig()}\nnotify: [*{SECRET}]\n",
        f"{virtual_rig()}\nnotify: [!{ADDRESS} a]\n",
        f"{virtual_rig()}\n  {ADDRESS}\n: [\n",
        f'{virtual_rig()}\nnotify: ["{ADDRESS}',
        virtual_rig().replace("name: virtual bench", f"name: {{a: '{ADDRESS}'}}"),
        virtual_rig().replace("seed: 1", f"seed: {ADDRESS}"),
    ],
)
def test_no_error_quotes_an_address_that_stands_in_a_wrong_place(text, tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as told:
        Rig.load(path)
    assert SECRET not in str(told.value) and "rig.yaml" in str(told.value)
