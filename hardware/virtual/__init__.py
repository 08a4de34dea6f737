"""The virtual rig: emulated board, heated springs and a robot that moves.

The virtual camera is in `hardware.vision`; boards are emulated in `hardware.emulator`.
"""
