"""Programs of the microcontrollers, in MicroPython's part of Python; their emulators run them unchanged.

The MOSFET board: `main.py` with the limits and the protocol; its driver is in `relay`. The current sensor:
`current_sensor.py` and `sensor_main.py`; its driver is in `sensor`. Drivers share no code with this. Which
pulses are allowed in a run is decided in `guardian`.
"""
