"""What the guardian takes from the program that starts it."""

import os
import stat
from types import SimpleNamespace

from eldir_hardware.guardian import _connection as isolation
from tests.paths import PACKAGES


def test_the_few_variables_that_the_guardian_needs(monkeypatch, tmp_path):
    here, others = tmp_path / "here", tmp_path / "others"
    for folder, mode in ((here, 0o755), (others, 0o777)):
        folder.mkdir()
        folder.chmod(mode)
    kept = {
        "HOME": "h",
        "LANG": "l",
        "LOGNAME": "n",
        "PATH": "p",
        "TZ": "z",
        "USER": "u",
        "XDG_STATE_HOME": "x",
    }
    given = kept | {"LC_ALL": "C", "PYTHONPATH": "/evil", "LD_PRELOAD": "/evil.so"}
    monkeypatch.setattr(os, "environ", given)
    own = {"PYDANTIC_DISABLE_PLUGINS": "__all__", "OPENBLAS_NUM_THREADS": "1"}
    assert isolation.clean_environment() == kept | {"LC_ALL": "C"} | own
    given["LD_LIBRARY_PATH"] = f"/usr:{others}:relative:{here}:/etc/passwd"
    assert isolation.clean_environment()["LD_LIBRARY_PATH"] == f"/usr:{here}"
    monkeypatch.chdir(here)
    assert isolation.clean_environment()["LD_LIBRARY_PATH"] == "/usr"
    given["LD_LIBRARY_PATH"] = "relative"
    assert "LD_LIBRARY_PATH" not in isolation.clean_environment()


def test_the_folders_from_which_the_guardian_imports(monkeypatch, tmp_path):
    here, others, file = tmp_path / "here", tmp_path / "others", tmp_path / "file"
    here.mkdir()
    others.mkdir()
    others.chmod(0o777)
    file.touch()
    homes = [str(PACKAGES[name].parent) for name in ("eldir", "eldir_hardware")]
    monkeypatch.setattr(
        isolation, "sys", SimpleNamespace(path=["", "/usr", str(here), str(others), str(file), "/usr"])
    )
    assert isolation.import_path() == ["/usr", str(here), *homes]
    monkeypatch.chdir(here)
    assert isolation.import_path() == ["/usr", *homes]
    monkeypatch.chdir(homes[0])
    assert isolation.import_path() == ["/usr", str(here), *homes], "the program's own folder stays"
    assert not stat.S_IWOTH & os.stat(homes[0]).st_mode
