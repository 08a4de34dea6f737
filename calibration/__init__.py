"""Arrays in, parameters out: camera and plane, comparison of motions, report. No devices."""
