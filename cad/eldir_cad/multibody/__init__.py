"""The robot as rigid hubs, strips and coils in contact with a table: a second physics, as a MuJoCo model
(MJCF).

Nothing here needs MuJoCo or simulates anything; `eldir_hardware.virtual.mujoco_body` does. The printed scene,
which treats hubs as points, is `eldir.built`.
"""
