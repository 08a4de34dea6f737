"""Damaged files of every kind that a user can hand in, each for its reader.

A sound file is changed at random: bytes, tokens, or values in the tree of a JSON or YAML file. The reader may
return, or raise `EldirError`; anything else, more than `TIME` seconds, or more than `MEMORY` is a fault.
"""

from __future__ import annotations

import copy
import json
import multiprocessing
import random
import resource
import signal
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np
import yaml

from eldir.built.scene import PrintedScene
from eldir.design import Design
from eldir.errors import EldirError
from eldir.evolution.designs import open_run
from eldir.evolution.own.run_folder import ProblemRun
from eldir.evolution.own.vectors import ProblemConfig
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.status import read_status
from eldir.lattice import Lattice
from eldir.terrain import Terrain, TerrainFile
from eldir.trajectory import Trajectory
from eldir_cad.kit import PRINTER
from eldir_cad.kit.prices import load_prices
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import kit_file, load_specification
from eldir_cad.packet.wiring_file import read_wiring
from eldir_calibration.identification.spring_record import load_spring_recording
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import Plane, TagBoard
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.log.recover import recover_log
from eldir_hardware.rig._board_hints import read_board_hints
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import real_rig
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.thermometer import read_thermometer
from eldir_hardware.vision.sources import open_source
from tests.eldir.evolution.printed.small_searches import SMALL
from tests.eldir.random_design import make_design
from tests.hardware.camera.lenses import lens_of
from tests.hardware.log.log_contents import EPOCH, NAMES, POSITIONS, picture
from tests.hardware.rigs_and_schedules import SCHEDULE, rig_text
from tests.paths import DATA

TIME, MEMORY = 5.0, 1 << 30
"""What one file may take [s of processor time, bytes]."""
_VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 2, 0.5, -0.0, 1e-300, 1e308, -1e308, 10**15, 10**18, -(10**30), 2**63, 2**31,
    "", "0", "nan", "x" * 10_000, "../../etc/passwd", "\x00", "\u202e", [], {}, [[]], [0] * 1000, [None],
    {"": None}, {"format": "x"}, [[0.0, 0.0]] * 100,
)  # fmt: skip
_TOKENS = (
    b"0", b"-", b"1e999", b"NaN", b"Infinity", b"null", b"true", b"{", b"}", b"[", b"]" * 50, b"[" * 5000,
    b'"', b"\\u0000", b"\x00", b"\xff", b"&a ", b"*a", b"<<: ", b"!!python/object:os.system ", b": ",
    b"\n- ", b",",
    b"9" * 400, b"e9", b"\t", b"\r\n", b"\xef\xbb\xbf", b"#",
)  # fmt: skip


_PRICES = "format: eldir-prices/1\ncurrency: EUR\nresin_kg: 180.0\nitems: {fuse: 0.4, lead: 0.9, fan: 12}\n"


class Format(NamedTuple):
    """One kind of file."""

    write: Callable[[Path], Path]
    """Writes sound files into a new folder; returns the one that is damaged."""
    read: Callable[[Path], object]
    tree: Callable[[Any], str] | None = None
    """Text of changed values, for a file that is a tree of values."""


class Fault(NamedTuple):
    """What must not happen."""

    format: str
    seed: int
    what: str

    def __str__(self) -> str:
        return f"{self.format}, seed {self.seed}: {self.what}"


def _file(name: str, text: str | bytes) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        data = text if isinstance(text, bytes) else text.encode()
        (folder / name).write_bytes(data)
        return folder / name

    return write


def _saved(name: str, save: Callable[[Path], object]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        save(folder / name)
        return folder / name

    return write


def _run(create: Callable[[Path], object]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        create(folder / "run")
        return folder / "run" / "run.json"

    return write


def _log(path: Path) -> None:
    with Recorder(path, channels=("front", "rear"), springs=("s4",), epoch_ns=EPOCH) as log:
        log.attach("design.json", b'{"format": "eldir-design/1"}')
        for i in range(12):
            log.on_frame(0.1 * i, picture(i))
            log.on_tracks(0.1 * i, NAMES, POSITIONS)
            log.on_relays(0.1 * i, (True, i > 5))
            log.on_temperatures(0.1 * i, (20.0 + i,))
        log.on_status(1.2, "player", "played to the end", {"cycles": 5})


def _read_whole_log(path: Path) -> object:
    log = read_log(path)
    return [frame.shape for _, frame in log.frames]


def _recover(path: Path) -> object:
    out = path.with_name("recovered.mcap")
    out.unlink(missing_ok=True)
    return recover_log(path, out)


def _recording(path: Path) -> None:
    rows = (f"{1.0 * i:.1f},{2.0 * (i % 7 > 3)},6.1,{22 + i},1" for i in range(40))
    path.write_text("t_s,current_a,voltage_v,temperature_c,fan\n" + "\n".join(rows) + "\n")


def _picture(path: Path) -> None:
    import cv2

    cv2.imwrite(str(path), picture(3))


def _json(values: Any) -> str:
    return json.dumps(values)


def _yaml(values: Any) -> str:
    return str(yaml.safe_dump(values))


_PAPER = EvolutionConfig(Lattice(4, 6), population=10, generations=3, iterations=4, seed=2)
_SCENE = (DATA / "built-scene-1.json").read_bytes()

FORMATS: dict[str, Format] = {
    "design": Format(
        _saved("design.json", make_design(1, Lattice(3, 6)).save), lambda p: Design.load(p).morphology, _json
    ),
    "terrain": Format(
        _saved("terrain.json", TerrainFile("paper", Terrain.rugged(np.random.default_rng(1))).save),
        lambda p: TerrainFile.load(p).lengths_of("printed", 1.14),
        _json,
    ),
    "schedule": Format(
        _saved("schedule.json", SCHEDULE.save), lambda p: ActuationSchedule.load(p).pulses(), _json
    ),
    "scene, format 1": Format(_file("scene.json", _SCENE), PrintedScene.load, _json),
    "scene": Format(
        _saved("scene.json", lambda p: PrintedScene.load(DATA / "built-scene-1.json").save(p)),
        PrintedScene.load,
        _json,
    ),
    "virtual rig": Format(_file("rig.yaml", rig_text(3, "design.json")), Rig.load, _yaml),
    "real rig": Format(_file("rig.yaml", real_rig("lcus", "/dev/ttyUSB0")), Rig.load, _yaml),
    "rig for rig off": Format(
        _file("rig.yaml", real_rig("modbus", "/dev/ttyUSB0")),
        lambda p: read_board_hints(p.read_bytes()),
        _yaml,
    ),
    "parts": Format(_file("parts.yaml", kit_file("parts.yaml").read_bytes()), load_specification, _yaml),
    "printer": Format(
        _file("printer.yaml", kit_file(f"{PRINTER}.yaml").read_bytes()),
        lambda p: load_printer(str(p)),
        _yaml,
    ),
    "prices": Format(_file("prices.yaml", _PRICES), load_prices, _yaml),
    "trajectory": Format(
        _saved(
            "trajectory.json", lambda p: Trajectory(NAMES, np.arange(5) / 5, np.ones((5, 3, 2))).save(p)
        ),
        Trajectory.load,
        _json,
    ),
    "lens": Format(
        _saved(
            "lens.json",
            lambda p: lens_of((640, 480), [500] * 2, [320, 240], [0] * 5).save(p),
        ),
        Lens.load,
        _json,
    ),
    "plane": Format(
        _saved("plane.json", lambda p: Plane(640, 480, np.eye(3), [320, 240], [0, 0], 0.1).save(p)),
        Plane.load,
        _json,
    ),
    "tags": Format(
        _file(
            "tags.json",
            json.dumps(TagBoard.at(np.eye(4, 2)).to_json()),
        ),
        TagBoard.load,
        _json,
    ),
    "wiring": Format(
        _file("wiring.csv", "spring,face,relay_channel\n0,front,1\n0,back,2\n1,front,3\n"),
        lambda p: read_wiring(p.parent),
    ),
    "thermometer": Format(_file("temperature", "21437\n"), read_thermometer),
    "recording of a spring": Format(_saved("spring.csv", _recording), load_spring_recording),
    "run": Format(
        _run(lambda p: RunFolder.create(p, _PAPER)), lambda p: open_run(p.parent).config.lattice, _json
    ),
    "run for building": Format(
        _run(lambda p: PrintedRun.create(p, SMALL)), lambda p: open_run(p.parent).config.lattice, _json
    ),
    "run of an own problem": Format(
        _run(lambda p: ProblemRun.create(p, ProblemConfig("hill"))),
        lambda p: read_status(open_run(p.parent)).summary(),
        _json,
    ),
    "log": Format(_saved("log.mcap", _log), _read_whole_log),
    "log to recover": Format(_saved("log.mcap", _log), _recover),
    "picture": Format(_saved("picture.png", _picture), lambda p: [f.shape for _, f in open_source(p)]),
}  # fmt: skip


def faults(name: str, folder: Path, tries: int, seed: int) -> list[Fault]:
    """Faults of one format in so many tries, each a file with a seed of its own; in a process that may not
    use more than `MEMORY` beyond what it has."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_try_all, args=(name, folder, tries, seed, theirs))
    process.start()
    theirs.close()
    found: list[Fault] = []
    try:
        while (message := ours.recv()) is not None:
            found.append(message)
    except EOFError:
        process.join()
        found.append(Fault(name, seed, f"the process ended with {process.exitcode}; see {folder}"))
    process.join()
    return found


def _try_all(name: str, folder: Path, tries: int, seed: int, out: Any) -> None:
    own = FORMATS[name]
    path = own.write(folder)
    sound = path.read_bytes()
    own.read(path)  # imports, and proves that the file is sound
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    warnings.simplefilter("error")  # a warning would be printed beside the one line
    for k in range(seed, seed + tries):
        path.write_bytes(damaged(sound, own.tree, random.Random(k)))
        try:
            with _limited():
                own.read(path)
        except EldirError as error:
            if len(str(error)) > 2000 or "\n" in str(error):
                out.send(Fault(name, k, f"a message of {len(str(error))} characters: {str(error)[:100]!r}"))
        except BaseException as error:
            last = traceback.extract_tb(error.__traceback__)[-1]
            out.send(
                Fault(name, k, f"{type(error).__name__}: {str(error)[:100]} ({last.filename}:{last.lineno})")
            )
    out.send(None)


@contextmanager
def _limited() -> Iterator[None]:
    def late(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"more than {TIME:g} s of processor time")

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, TIME)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def damaged(sound: bytes, tree: Callable[[Any], str] | None, rng: random.Random) -> bytes:
    """A file with one to four changes."""
    data = sound
    if tree is not None and rng.random() < 0.6:
        values = yaml.safe_load(sound) if tree is _yaml else json.loads(sound)
        for _ in range(rng.randrange(1, 4)):
            values = _changed(values, rng)
        data = tree(values).encode("utf-8", "surrogatepass")
        if rng.random() < 0.8:
            return data
    for _ in range(rng.randrange(1, 4)):
        data = _cut(data, rng)
    return data


def _cut(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(data) + 1)
    end = min(len(data), at + rng.choice((1, 1, 4, 16, 256, 4096)))
    match rng.randrange(6):
        case 0:
            return data[:at]
        case 1:
            return data[:at] + data[end:]
        case 2:
            return data[:at] + rng.choice(_TOKENS) + data[end:]
        case 3:
            return data[:at] + data[at:end] * rng.choice((2, 3, 50)) + data[end:]
        case 4:
            return data[:at] + rng.randbytes(end - at) + data[end:]
        case _:
            return data[:at] + bytes(b ^ 1 << rng.randrange(8) for b in data[at : at + 1]) + data[at + 1 :]


def _changed(values: Any, rng: random.Random) -> Any:
    """The tree with one value changed, left out, moved or doubled."""
    values = copy.deepcopy(values)
    places = list(_places(values))
    if not places:
        return rng.choice(_VALUES)
    parent, key = rng.choice(places)
    match rng.randrange(6):
        case 0:
            del parent[key]
        case 1:
            other, name = rng.choice(places)
            parent[key] = copy.deepcopy(other[name])
        case 2 if isinstance(parent[key], int | float) and not isinstance(parent[key], bool):
            parent[key] *= rng.choice((-1, 0, 1e-9, 0.5, 2, 1000, 1e9))
        case 3 if isinstance(parent, dict):
            parent[rng.choice(("x", "", "format", "self", "__class__"))] = parent.pop(key)
        case 4 if isinstance(parent, list):
            parent.insert(key, copy.deepcopy(parent[key]))
        case _:
            parent[key] = copy.deepcopy(rng.choice(_VALUES))
    return values


def _places(values: Any) -> Iterator[tuple[Any, Any]]:
    keys = values if isinstance(values, dict) else range(len(values)) if isinstance(values, list) else ()
    for key in list(keys):
        yield values, key
        yield from _places(values[key])
