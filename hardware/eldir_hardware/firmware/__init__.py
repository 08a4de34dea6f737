"""Programs of the microcontrollers, in MicroPython's part of Python; their emulators run them unchanged.

The MOSFET board: `main.py` with the limits and the protocol; its driver is in `relay`. The current sensor:
`current_sensor.py`; its driver is `eldir_hardware.current_sensor`. Drivers share no code with it. Which
pulses are allowed in a run is decided in `guardian`.
"""
