"""What cannot be a port: one line, expected and found, by every command that takes one."""

import pytest
import yaml

from eldir.errors import InputError
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import real_rig
from eldir_hardware.safety.off_targets import find_off_targets
from tests.hardware.emulated_rigs import rig_file, run

WRONG = {
    "": "the name of the port is empty",
    "  ": "the name of the port is empty",
    "/dev/tty\0USB0": r"invalid characters in the name of port '/dev/tty\x00USB0'",
    "/dev/tty\nUSB0": r"invalid characters in the name of port '/dev/tty\nUSB0'",
    "/dev": "/dev is a folder",
    "socket://host:1": "socket://host:1 is not a serial port of this computer",
}
IN_A_FILE = WRONG | {"socket://host:1": "socket://hidden is not a serial port of this computer"}
"""What a rig file has in a wrong place may be an address of `notify`."""


@pytest.mark.parametrize("port", WRONG)
def test_a_new_rig_file_names_a_port(tmp_path, port):
    done = run("new", "--board", "lcus", "--port", port, "--out", tmp_path / "rig.yaml")
    assert done.exit_code == 2 and not (tmp_path / "rig.yaml").exists()
    told = " ".join(done.output.replace("│", " ").split())
    assert f"{WRONG[port]}: expected a serial port" in told, told


@pytest.mark.parametrize("entry", ["board", "sensor"])
@pytest.mark.parametrize("port", WRONG)
def test_a_rig_file_with_another_name_is_not_loaded(tmp_path, port, entry):
    changes = {} if entry == "board" else {"sensor": {"kind": "ina226", "port": port}}
    path = rig_file(tmp_path / "rig.yaml", "lcus", port if entry == "board" else "/dev/ttyUSB0", **changes)
    with pytest.raises(InputError) as caught:
        Rig.load(path)
    assert f"{entry}.port" in str(caught.value) and IN_A_FILE[port] in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("port", WRONG)
@pytest.mark.parametrize("command", ["reset", "doctor"])
def test_no_command_takes_such_a_file(tmp_path, port, command):
    path = tmp_path / "rig.yaml"
    values = yaml.safe_load(real_rig("lcus", "/dev/ttyUSB0"))
    values["board"]["port"] = port
    path.write_text(yaml.safe_dump(values))
    done = run(command, "--rig", path)
    assert done.exit_code == 1 and isinstance(done.exception, InputError), done.exception
    assert "\n" not in str(done.exception) and IN_A_FILE[port] in str(done.exception)


@pytest.mark.parametrize("port", WRONG)
def test_off_takes_no_other_name(tmp_path, port):
    with pytest.raises(InputError) as caught:
        find_off_targets(None, port, None, tmp_path)
    assert str(caught.value).startswith(f"{WRONG[port]}; expected a serial port")


def test_off_leaves_out_the_names_of_a_file_that_are_no_ports(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("board:\n  port: /dev\n  kind: lcus\nother:\n  port: /dev/no-such-port\n")
    targets, remarks = find_off_targets(path, None, None, tmp_path)
    assert [target.port for target in targets] == ["/dev/no-such-port"]
    assert any(remark.startswith("/dev is a folder; expected a serial port") for remark in remarks)
