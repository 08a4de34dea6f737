"""The folder of the latched stops, file by file: what is trusted, what is written, what is left behind."""

import errno
import os
import pwd
import stat
from contextlib import contextmanager
from pathlib import Path

import pytest

from eldir_hardware.safety import state_folder as module
from eldir_hardware.safety.state_folder import StateError, StateFolder, open_state_folder
from tests.raised import raises

NOWHERE = Path("/no/shared/folder")
root_only = pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files to other users")


@pytest.fixture(autouse=True)
def own(tmp_path, monkeypatch):
    """The user's folder of this test."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state" / "eldir"


@contextmanager
def masked(mask: int):
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


@contextmanager
def opened(path: Path, shared: bool):
    handle = os.open(path, os.O_RDONLY)
    try:
        yield StateFolder(handle, path, shared)
    finally:
        os.close(handle)


def put(path: Path, data: bytes = b"{}", mode: int = 0o600, user: int | None = None) -> None:
    path.write_bytes(data)
    path.chmod(mode)
    if user is not None:
        os.chown(path, user, -1)


def test_files_of_the_user_are_read_and_others_are_not(own):
    with open_state_folder(NOWHERE) as folder:
        put(own / "good", b"good")
        assert folder.read("good") == b"good"
        put(own / "group", mode=0o620)
        put(own / "all", mode=0o602)
        for name in ("group", "all"):
            with raises(StateError, "state.untrusted", match=rf"{own}/{name} .*other users can write it"):
                folder.read(name)
        os.mkfifo(own / "pipe")
        with raises(StateError, "state.untrusted", match="pipe .*not a regular file"):
            folder.read("pipe")
        (own / "link").symlink_to(own / "good")
        with raises(StateError, "state.untrusted", match="link .*Too many levels"):
            folder.read("link")
        with pytest.raises(FileNotFoundError):
            folder.read("none")


@root_only
@pytest.mark.parametrize("shared", [False, True])
def test_the_owner_counts_unless_a_group_shares_the_folder(shared, tmp_path):
    put(tmp_path / "theirs", b"theirs", user=12345)
    put(tmp_path / "group", b"group", mode=0o660)
    put(tmp_path / "all", mode=0o662)
    with opened(tmp_path, shared) as folder:
        if shared:
            assert folder.read("theirs") == b"theirs" and folder.read("group") == b"group"
        else:
            with raises(StateError, "state.untrusted", match="theirs .*belongs to user 12345"):
                folder.read("theirs")
            with raises(StateError, "state.untrusted", match="group .*other users can write it"):
                folder.read("group")
        with raises(StateError, "state.untrusted", match="all .*other users can write it"):
            folder.read("all")


def test_the_largest_file_and_the_most_files(own):
    with open_state_folder(NOWHERE) as folder:
        put(own / "largest", b" " * 65_536)
        assert len(folder.read("largest")) == 65_536
        put(own / "larger", b" " * 65_537)
        with raises(StateError, "state.untrusted", match="65537 bytes"):
            folder.read("larger")
        for i in range(1022):
            (own / f"{i}").touch()
        assert folder.names() == sorted([*(str(i) for i in range(1022)), "larger", "largest"])
        (own / "one more").touch()
        with raises(StateError, "state.too-many-files"):
            folder.names()


def test_a_file_that_cannot_be_read_is_not_trusted(own, monkeypatch):
    with open_state_folder(NOWHERE) as folder:
        put(own / "good")

        def fails(*_: object) -> bytes:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

        with monkeypatch.context() as patch:
            patch.setattr(os, "read", fails)
            with raises(StateError, "state.untrusted", match="good .*Input/output error"):
                folder.read("good")


def test_no_file_stays_open(own):
    before = len(os.listdir("/proc/self/fd"))
    with open_state_folder(NOWHERE) as folder:
        folder.write("a", b"a")
        folder.read("a")
        folder.remove("a")
    assert len(os.listdir("/proc/self/fd")) == before


@pytest.mark.parametrize(("shared", "mode"), [(False, 0o600), (True, 0o660)])
def test_what_is_written_has_the_mode_of_its_folder_whatever_the_mask(shared, mode, tmp_path):
    for mask in (0, 0o077):
        with opened(tmp_path, shared) as folder, masked(mask):
            folder.write("a", b"text")
        assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == mode
        (tmp_path / "a").unlink()


def test_a_file_is_on_the_disk_before_it_has_its_name_and_its_name_too(own, monkeypatch):
    """Without that, a loss of power leaves an empty file, or none."""
    synced: list[tuple[int, bool]] = []
    fsync = os.fsync

    def noted(handle: int) -> None:
        status = os.fstat(handle)
        synced.append((-1 if stat.S_ISDIR(status.st_mode) else status.st_size, (own / "a").exists()))
        fsync(handle)

    with open_state_folder(NOWHERE) as folder:
        monkeypatch.setattr(os, "fsync", noted)
        folder.write("a", b"text")
        assert synced == [(4, False), (-1, True)]
        folder.remove("a")
        assert synced[2:] == [(-1, False)]
        folder.remove("a")  # another program was faster


def test_a_file_that_cannot_be_written_leaves_the_old_one_and_nothing_else(own, monkeypatch):
    with open_state_folder(NOWHERE) as folder:
        folder.write("a", b"old")

        def full(*_: object, **__: object) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        def full_and_gone(draft: str, name: str, *, src_dir_fd: int, dst_dir_fd: int) -> None:
            os.unlink(draft, dir_fd=src_dir_fd)
            full()

        for failure in (full, full_and_gone):
            with monkeypatch.context() as patch:
                patch.setattr(os, "replace", failure)
                with pytest.raises(OSError, match="No space left"):
                    folder.write("a", b"new")
            assert folder.names() == ["a"] and folder.read("a") == b"old"


def test_the_folder_is_made_for_its_user_alone(own):
    with masked(0), open_state_folder(NOWHERE):
        pass
    for made in (own, own.parent):
        assert stat.S_IMODE(made.stat().st_mode) == 0o700
    own.chmod(0o755)  # others may read it
    with open_state_folder(NOWHERE):
        pass


def test_where_the_folder_is(tmp_path, monkeypatch):
    """A relative XDG_STATE_HOME counts as none; then the account's home counts, not the environment's."""
    account = pwd.getpwuid(os.geteuid())
    home = tmp_path / "new" / "home"

    def known(user: int) -> pwd.struct_passwd:
        return pwd.struct_passwd([*account[:5], str(home), account[6]])

    def unknown(user: int) -> pwd.struct_passwd:
        raise KeyError(user)

    monkeypatch.setattr(pwd, "getpwuid", known)
    monkeypatch.setenv("HOME", str(tmp_path / "environment"))
    for value in (None, "", "state"):
        if value is None:
            monkeypatch.delenv("XDG_STATE_HOME")
        else:
            monkeypatch.setenv("XDG_STATE_HOME", value)
        with open_state_folder(NOWHERE) as folder:
            assert folder.path == home / ".local" / "state" / "eldir" and folder.path.is_dir()
    monkeypatch.setattr(pwd, "getpwuid", unknown)
    with open_state_folder(NOWHERE) as folder:
        assert folder.path == tmp_path / "environment" / ".local" / "state" / "eldir"
    monkeypatch.delenv("HOME")
    assert module._user_path() == Path("/.local/state/eldir")


def test_a_folder_that_cannot_be_made_or_opened(own, tmp_path):
    (tmp_path / "state").write_text("a file")
    with (
        raises(StateError, "state.no-access", match="set XDG_STATE_HOME to a folder of your own"),
        open_state_folder(NOWHERE),
    ):
        pass
    (tmp_path / "state").unlink()
    own.parent.mkdir()
    own.write_text("a file")
    with (
        raises(StateError, "state.no-access", match="Not a directory; make it a folder of your own"),
        open_state_folder(NOWHERE),
    ):
        pass
    with (
        raises(StateError, "state.no-access", match="Not a directory; ask to be in its group"),
        open_state_folder(own),
    ):
        pass


def test_a_parent_that_all_may_write_is_refused_unless_it_is_sticky(own):
    own.parent.mkdir()
    own.parent.chmod(0o1777)  # as /tmp
    with open_state_folder(NOWHERE):
        pass
    own.parent.chmod(0o777)
    with raises(StateError, "state.open-folder", match="by every user"), open_state_folder(NOWHERE):
        pass


@root_only
def test_a_folder_of_another_user_is_refused(own):
    own.mkdir(parents=True)
    os.chown(own, 12345, -1)
    with raises(StateError, "state.open-folder", match="belongs to user 12345"), open_state_folder(NOWHERE):
        pass


@root_only
def test_a_shared_folder_that_this_user_may_not_write(tmp_path, monkeypatch):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o2770)
    asked = []

    def refused(path: object, mode: int) -> bool:
        asked.append(mode)
        return False

    monkeypatch.setattr(os, "access", refused)
    with raises(StateError, "state.no-access", match="ask to be in its group"), open_state_folder(shared):
        pass
    assert asked == [os.W_OK | os.X_OK]
