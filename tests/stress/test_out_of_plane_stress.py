"""What a film tells of a robot that leaves its plane, against MuJoCo's own places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.gait import Gait, heat_faces
from eldir.design import marked_masses
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir_calibration.transfer.biplane_walks import yaw_and_roll
from eldir_calibration.transfer.mujoco_walks import sample_face_springs
from eldir_hardware.camera.plane import FieldOfView
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.camera.projection import Projection
from eldir_hardware.vision.out_of_plane import PlaneObserver
from eldir_hardware.vision.pipeline import track_frames
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.calibration.dynamics.hidden_rigs import DUTY, PERIOD, PHASE, walker

pytest.importorskip("mujoco")
CYCLES, STEPS = 2, 5  # steps of 0.05 s between pictures


@pytest.mark.stress
@pytest.mark.parametrize(("seed", "apart"), [(1, 0.0), (2, 0.03), (3, 0.0)])
def test_intervals_hold_what_mujoco_knows(seed: int, apart: float) -> None:
    """`apart`: by how much the current of each face differs from the mean, besides all that a seed draws."""
    from eldir_hardware.virtual.biplane_body import BiplaneBody

    body, marks = walker().morphology, marked_masses(walker().morphology)
    springs = SpringParameters()
    drawn = sample_face_springs(body.motors, seed, RigTolerances().perturb_by_seed(springs, seed))
    own = [
        replace(s, current_limit=s.current_limit * (1 + apart * (1 - 2 * (i % 2))))
        for i, s in enumerate(drawn)
    ]
    gait = Gait(PERIOD, np.array([0.0, PHASE]), np.full(2, DUTY))
    table = heat_faces(gait, own, CYCLES, body.motor_hubs)
    robot = BiplaneBody(body, seed, springs)
    robot.move(np.repeat(table.lengths[:1], 40, axis=0).reshape(40, body.motors, 2), table.interval)
    camera = VirtualCamera(seed, FieldOfView.around(robot.positions))
    outsides, frames = [], []
    for row in range(0, len(table.lengths) - STEPS, STEPS):
        discs = robot.discs
        outsides.append(discs.outsides)
        frames.append((row * table.interval, camera.render_solid(discs, body.springs, marks)))
        robot.move(table.lengths[row + 1 : row + STEPS + 1].reshape(STEPS, body.motors, 2), table.interval)
    plane = calibrate_plane([image for _, image in frames[:10]], camera.board)
    found = track_frames(frames, plane, layout=body.positions[marks] * BuiltParameters().scale)
    number = {mass: k for k, mass in enumerate(marks.tolist())}
    strips = [
        (number[a], number[b])
        for (a, b), active in zip(body.springs.tolist(), body.active.tolist(), strict=True)
        if not active and a in number and b in number
    ]
    observer = PlaneObserver(found.trajectory, found.sizes, np.array(strips), plane)
    places = np.array(outsides)
    yaw, lean = yaw_and_roll(places[0].reshape(-1, 3), places.reshape(len(places), -1, 3))
    distance = -Projection.of(camera.plane, float(camera.lens.focal_px[0])).position[1]
    held, errors = [], []
    for t in np.arange(2.0, found.trajectory.times[-1] - 2, 4.0).tolist():
        pose = observer.estimate(t, t + 2.0)
        assert pose is not None
        i = int(np.searchsorted(found.trajectory.times, t + 1.0))
        depth = places[i, marks, 0, 1].mean() / distance
        pairs = (pose.yaw, abs(yaw[i]), 0.044), (pose.lean, abs(lean[i]), 0.022), (pose.depth, depth, 0.0025)
        held.append([one.low - grid <= true <= one.high + grid for one, true, grid in pairs])
        errors.append(abs(pose.depth.median - depth))
    start, end = observer.estimate(0.0, 1.0), observer.estimate(t, t + 2.0)
    assert start is not None and end is not None
    # Of the marked hubs: the robot's shape changes too, and its middle with it.
    middle = places[[2, i]][:, marks].mean(axis=(1, 2))[:, 0]
    filmed = [
        float(np.nanmedian(found.trajectory.positions[k - 2 : k + 3, :, 0], axis=0).mean()) for k in (2, i)
    ]
    error = abs(np.diff(filmed) - np.diff(middle))[0]
    bound = end.path_error(0.0247, float(np.ptp(places[0, :, 0, 0])) / 2)
    print(
        f"\n| {seed}, {apart:.0%} | {len(strips)} | {np.mean(held, axis=0).round(2).tolist()} | "
        f"{np.degrees(yaw[i]):.0f} | {np.degrees(end.yaw.low):.0f} to {np.degrees(end.yaw.high):.0f} | "
        f"{np.degrees(np.abs(lean)).max():.1f} | {100 * depth:.1f} | {100 * end.depth.low:.1f} to "
        f"{100 * end.depth.high:.1f} | {100 * np.mean(errors):.1f} | {1e3 * error:.1f} | {1e3 * bound:.1f} |"
    )
    assert (np.mean(held, axis=0) > 0.85).all()
    assert error < bound and observer.find_loss() is None
