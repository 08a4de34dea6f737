"""Read the log of a run: python examples/read_log.py demo/log.mcap"""

import sys

import numpy as np

from eldir_hardware.log.reader import read_log

log = read_log(sys.argv[1] if len(sys.argv) > 1 else "demo/log.mcap")
print(f"{log.frame_count} frames; files kept with the log: {', '.join(sorted(log.attachments))}")
print(f"contacts {', '.join(log.channels)}: {len(log.relay_times)} readings")
for k, name in enumerate(log.channels):
    closed = np.diff(log.relays[:, k].astype(int), prepend=0)
    print(f"  {name}: closed {int((closed > 0).sum())} times")
for name, degrees in zip(log.springs, log.temperatures.T, strict=True):
    print(f"  {name}: {degrees.min():.0f} to {degrees.max():.0f} C (modelled)")
for time, picture in log.frames:
    print(f"first frame at {time:.2f} s, {picture.shape[1]} x {picture.shape[0]} pixels")
    break
