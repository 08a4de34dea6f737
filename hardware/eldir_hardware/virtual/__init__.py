"""The virtual rig: emulated board, heated springs and a robot that moves.

The virtual camera is in `eldir_hardware.vision`; boards are emulated in `eldir_hardware.emulator`.
"""
