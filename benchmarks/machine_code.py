"""Instructions and loops of assembled kernels (`nvdisasm`), and how long one warp takes for them.

Short loops of known length are unrolled; the others remain loops. A step of a robot is a loop with barriers
that holds no other loop with barriers.
"""

from __future__ import annotations

import re
import subprocess
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

from benchmarks.assembly import AssembledKernel, find_tool

ARITHMETIC, SHARED, L1, L2 = 4, 30, 40, 270
"""Cycles until a result of arithmetic, of shared memory and of both caches is there: H100, rounded, from
"Benchmarking and dissecting the Nvidia Hopper GPU architecture" (Luo et al. 2024, arXiv 2402.13499)."""
BARRIER = 30
FUNCTION = 20
"""Cycles of a barrier, and of a root, a reciprocal or a conversion, about."""


class Instruction(NamedTuple):
    name: str
    """With its modifiers, such as LDG.E.64."""
    operands: str
    target: str
    """The label that a branch goes to, or nothing."""

    @property
    def kind(self) -> str:
        """Name without modifiers; LD, of an address of any memory, and LDG are one kind."""
        name = self.name.partition(".")[0]
        return {"LD": "LDG", "ST": "STG"}.get(name, name)

    @property
    def numbers(self) -> int:
        """Numbers (f32) that it loads from global memory; 64 bits are the address of an array."""
        if self.kind != "LDG" or ".64" in self.name:
            return 0
        return 4 if ".128" in self.name else 1


class Loop(NamedTuple):
    """A loop without the loops in it."""

    first: int
    last: int
    depth: int
    own: list[Instruction]
    inner: list[Loop]

    @property
    def barriers(self) -> int:
        return sum(one.kind == "BAR" for one in self.own)

    @property
    def numbers(self) -> int:
        """Numbers (f32) that a thread loads from global memory each time round."""
        return sum(one.numbers for one in self.own)

    def count(self, *kinds: str) -> int:
        return sum(one.kind in kinds for one in self.own)

    def walk(self) -> Iterator[Loop]:
        """This loop and all within it."""
        yield self
        for loop in self.inner:
            yield from loop.walk()


@cache
def _disassemble(file: Path) -> str:
    command = [find_tool("nvdisasm"), "-c", "-ndf", str(file)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


_INSTRUCTION = re.compile(r"\s+/\*[0-9a-f]+\*/\s+(?:@!?U?P\w+\s+)?([A-Z]\S*)\s*(.*?)\s*;")
_LABEL = re.compile(r"(\.L_x_\d+):")


def read_loops(kernel: AssembledKernel) -> Loop:
    """All loops of a kernel, as the inner ones of one that is the whole kernel. Raises: EldirError."""
    _, _, text = _disassemble(kernel.file).partition(f"\n.text.{kernel.kernel}:\n")
    text, _, _ = text.partition("\n//----")
    instructions: list[Instruction] = []
    labels: dict[str, int] = {}
    for line in text.splitlines():
        if label := _LABEL.match(line):
            labels[label[1]] = len(instructions)
        elif found := _INSTRUCTION.match(line):
            target = re.search(r"\.L_x_\d+", found[2]) if found[1].startswith("BRA") else None
            instructions.append(Instruction(found[1], found[2], target[0] if target else ""))
    ends: dict[int, int] = {}
    for i, one in enumerate(instructions):
        begin = labels.get(one.target, i)
        if begin < i:
            ends[begin] = i
    return _nest(instructions, 0, len(instructions) - 1, sorted(ends.items()), 0)


def _nest(
    instructions: Sequence[Instruction], first: int, last: int, spans: Sequence[tuple[int, int]], depth: int
) -> Loop:
    own: list[Instruction] = []
    inner: list[Loop] = []
    at = first
    for begin, end in spans:
        if begin >= at and end <= last:  # else within the loop before, or not nested
            own += instructions[at:begin]
            within = [span for span in spans if begin < span[0] and span[1] <= end]
            inner.append(_nest(instructions, begin, end, within, depth + 1))
            at = end + 1
    own += instructions[at : last + 1]
    return Loop(first, last, depth, own, inner)


def step_loops(kernel: Loop) -> list[Loop]:
    """The loops over time steps, in their order."""
    return [
        loop
        for loop in kernel.walk()
        if loop.depth and loop.barriers and not any(one.barriers for one in [*loop.walk()][1:])
    ]


def warp_cycles(instructions: Sequence[Instruction], load: int = L1) -> int:
    """Cycles of one warp that has a multiprocessor for itself. It starts an instruction each cycle, in their
    order, as soon as its operands are there. `load`: cycles of a load from global memory.

    Branches are passed: both sides of an `if` are counted."""
    ready: dict[str, int] = {}
    now = 0
    for one in instructions:
        results, operands = _registers(one)
        now = max([now + 1, *(ready.get(name, 0) for name in operands)])
        if one.kind == "BAR":
            now += BARRIER
        ready |= dict.fromkeys(results, now + _latency(one, load))
    return now


def _latency(one: Instruction, load: int) -> int:
    if one.kind in ("MUFU", "I2F", "F2I", "I2FP", "SHFL", "S2R"):
        return FUNCTION
    return {"LDG": load, "LDS": SHARED, "ATOM": L2, "ATOMS": SHARED}.get(one.kind, ARITHMETIC)


_REGISTER = re.compile(r"\b(U?[RP])(\d+)(\.64)?")
_STORES = ("STG", "STS", "BAR", "BRA", "EXIT", "RED")


def _registers(one: Instruction) -> tuple[list[str], list[str]]:
    """Names of the registers that an instruction writes, and that it reads."""
    result, _, operands = one.operands.partition(",")
    if one.kind in _STORES:
        result, operands = "", one.operands
    wide = 4 if ".128" in one.name else 2 if ".64" in one.name or "WIDE" in one.name else 1
    written = [f"{kind}{int(n) + k}" for kind, n, _ in _REGISTER.findall(result) for k in range(wide)]
    read = [
        f"{kind}{int(n) + k}"
        for kind, n, pair in _REGISTER.findall(operands)
        for k in range(2 if pair else 1)
    ]
    return written, read


def describe_loops(kernel: AssembledKernel) -> Iterator[str]:
    """Lines for a person: the loops with their instructions, those in inner loops not counted."""
    yield f"{kernel.kernel} sm_{kernel.architecture}, {kernel.registers} registers"
    yield "loop        instructions barriers cycles addresses numbers shared stores  most frequent"
    for loop in read_loops(kernel).walk():
        addresses = loop.count("LDG") - sum(one.numbers > 0 for one in loop.own)
        frequent = " ".join(f"{kind} {n}" for kind, n in Counter(one.kind for one in loop.own).most_common(7))
        name = "  " * loop.depth + f"{loop.first}-{loop.last}"
        yield (
            f"{name:16} {len(loop.own):7} {loop.barriers:8} {warp_cycles(loop.own):6} {addresses:9} "
            f"{loop.numbers:7} {loop.count('LDS', 'STS'):6} {loop.count('STG'):6}  {frequent}"
        )
