"""Programs around the nodes: `rig_process`, `run_schedule`, and what the launch files have in common.

Executables keep the names that `ros2 run` knows.
"""
