"""Current and voltage of each channel, measured: data sheets of the chips, the line protocol, the driver.

The microcontroller that reads the chips is in `eldir_hardware.firmware`; what the guardian concludes, in
`eldir_hardware.guardian.measured_heat`.
"""
