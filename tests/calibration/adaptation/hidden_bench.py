"""A bench on which an adaptation is made without pictures, for several test modules."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from eldir.errors import EldirError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.trajectory import Trajectory
from eldir_calibration.adaptation.loop import adapt
from eldir_calibration.adaptation.runs import Adaptation, AdaptationConfig
from eldir_calibration.dynamics.recording import INTERVAL, FilmedBody, Recording, predict_markers
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule
from tests.calibration.adaptation.short_adaptation import FEW, make_walker
from tests.hardware.rigs_and_schedules import rig_text

IMPOSSIBLE = "the coil of spring 2-3 would buckle on a printed robot, first 2.0 s after power-on"
OFF = {"hot_length": -0.8, "current": 0.5, "friction": 0.5}


class Bench:
    """A rig in a folder, and a robot on it whose parameters only this class knows. It walks as the engine
    says of a coarse robot, and its log holds tracks instead of pictures."""

    def __init__(self, folder: Path):
        self.folder, self.design_file, self.rig_file = folder, folder / "design.json", folder / "rig.yaml"
        self.design = make_walker()
        self.design.save(self.design_file)
        self.rig_file.write_text(rig_text(seed=4, design="design.json"))
        self.fails_in_run = 0
        self.is_cold = False
        self.off = OFF
        self.driven: list[str] = []
        self.decided: dict[str, bytes] = {}

    @property
    def rig(self) -> Rig:
        return Rig.load(self.rig_file)

    def adapt(self, out: str = "out", config: AdaptationConfig = FEW) -> Adaptation:
        return adapt(self.design_file, self.rig, self.folder / out, self.drive, config)

    def drive(self, schedule: ActuationSchedule, log: Path) -> None:
        self.driven.append(log.parent.name)
        if self.fails_in_run == int(log.parent.name[-2:]):
            log.write_bytes(b"the first records of a log")
            raise EldirError("the supply has failed")
        channels, states = schedule.sampled(INTERVAL)
        own = {entry.channel: entry.spring for entry in self.rig.channels}
        motors = [[channels.index(c) for c in channels if own[c] == m] for m in range(2)]
        on = np.stack([states[:, columns].mean(axis=1) for columns in motors], axis=1)
        names = tuple(f"m{i + 1}" for i in range(len(self.design.marks)))
        times = np.arange(0.0, len(on) * INTERVAL, 0.1)
        blank = Recording(Trajectory(names, times, np.zeros((len(times), len(names), 2))), on, 0.0, 1.0, 1)
        nominal = RobotParameters(BuiltParameters().with_hubs(), self.rig.spring_parameters())
        body = FilmedBody(self.design.morphology, self.design.marks, self.design.ballast / 2)
        moving = replace(blank, contact_shares=0.0 * on) if self.is_cold else blank
        truth = nominal.at(tuple(self.off), list(self.off.values()))
        (moved,) = predict_markers(body, [moving], [truth], coarse=True)[0]
        springs = [f"spring{entry.spring}_{entry.face}" for entry in self.rig.channels]
        with Recorder(log, [f"channel{c}" for c in range(1, 5)], springs) as recorder:
            recorder.attach("schedule.json", json.dumps(schedule.to_json()).encode())
            recorder.attach("rig.yaml", self.rig_file.read_bytes())
            recorder.attach("design.json", self.design_file.read_bytes())
            if log.parent.name == "run_02":
                recorder.on_status(0.0, "virtual rig", IMPOSSIBLE, good=False)
            recorder.on_relays(0.0, [False] * 4)
            closed = dict.fromkeys(range(1, 5), False)
            for t, changes in schedule.switchings():
                closed |= changes
                recorder.on_relays(t, list(closed.values()))
            for t, marks in zip(times, moved, strict=True):
                recorder.on_tracks(t, names, marks)


def files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix == ".json"
    }
