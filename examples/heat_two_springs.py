"""Heat two springs of a virtual rig for three seconds; the rig file of a real one heats that one."""

import tempfile
from pathlib import Path

from eldir_hardware import Rig, open_bank
from eldir_hardware.rig.template import virtual_rig

path = Path(tempfile.mkdtemp()) / "rig.yaml"
path.write_text(virtual_rig())
rig = Rig.load(path)
with open_bank(rig) as (bank, clock), bank.armed():  # everything is off, and proven off, on any way out
    start = max(clock.now() + 0.5, bank.ready_at)
    bank.heat(start, {1: 3.0, 3: 3.0})  # channel: seconds
    bank.wait_until(
        start + 8.0,
        lambda now: print(f"{now.t - start:.1f} s", now.closed, [round(c) for c in now.temperatures]),
    )
print(bank.proof)
