"""Programs of other users, which only root can start. They run the same interpreter as the tests."""

import os
import subprocess
import sys
from pathlib import Path

# In a mount namespace of its own, the folder in the way (such as /root) holds nothing but the interpreter.
_REACH = (
    'mount --bind "$1" "$2" && mount --rbind "$3" "$4" && shift 4 && '
    'user=$1 && group=$2 && shift 2 && exec setpriv --reuid="$user" --regid="$group" --groups="$group" "$@"'
)


def barred() -> Path | None:
    """The folder on the way to the interpreter that other users cannot enter."""
    prefix = Path(os.path.realpath(sys.base_prefix))
    return next((p for p in reversed([prefix, *prefix.parents]) if not p.stat().st_mode & 0o001), None)


def start(user: int, base: Path, words: list[str], group: int | None = None) -> subprocess.Popen:
    """Start a program of a user, with the group as its only one; its home is a folder in `base`."""
    home, group = base / str(user), user if group is None else group
    before: list[str] = []
    if (bar := barred()) is not None:
        prefix = Path(os.path.realpath(sys.base_prefix))
        way = base / "way"
        (way / prefix.relative_to(bar)).mkdir(parents=True, exist_ok=True)
        mounts = [str(prefix), str(way / prefix.relative_to(bar)), str(way), str(bar)]
        before = ["unshare", "--mount", "sh", "-c", _REACH, "sh", *mounts, str(user), str(group)]
    return subprocess.Popen(
        [*before, *words],
        **({} if before else {"user": user, "group": group, "extra_groups": [group]}),
        cwd=home,
        env={"PATH": os.environ["PATH"], "HOME": str(home), "XDG_STATE_HOME": str(home)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
