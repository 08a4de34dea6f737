"""Limits that hold while heating: on-times, rests, duty, current and modelled temperature."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from eldir.built.heat import HeatModel, SpringState
from eldir.core.records import FloatArray
from hardware.rig.configuration import Rig
from hardware.safety import limits
from hardware.safety.limits import LimitError

_MODEL_STEP, _COOLING_STEP = 0.1, 0.5  # while something heats, and while nothing does [s]
_SLACK = 0.05  # contacts do not move to the millisecond [s]
_WINDOW = 60.0  # over which the duty counts [s]


class Interlock:
    """Follows the board's reports. Springs of the greatest tolerated resistance are modelled too."""

    def __init__(self, rig: Rig, now: float):
        limits.check_rig(rig)
        self._rig = rig
        self._column = {c.channel: i for i, c in enumerate(rig.channels)}
        self._indices = [c.channel - 1 for c in rig.channels]
        count = len(rig.channels)
        worst = limits.worst_springs(rig)
        # A contact welded behind a contactor is not seen: its spring heats whenever any does.
        welded = [worst] if rig.master_channel is not None else []
        nominal = rig.spring_parameters()
        self._model = HeatModel([nominal] * count + [worst] * count + welded)
        self._state = SpringState.cold(2 * count + len(welded), worst)
        self._parts = limits.shares(rig, nominal), limits.shares(rig, worst, worst=True)
        self._modelled_to = now
        self._believed = (False,) * rig.board.channels
        self._closed_since: dict[int, float] = {}
        self._opened_at: dict[int, float] = {}
        self._spent: deque[tuple[int, float, float]] = deque()  # channel, closed, opened
        self.hottest = worst.ambient
        """Highest modelled temperature so far of the nominal springs [C]."""

    @property
    def temperatures(self) -> tuple[float, ...]:
        """Temperature of the nominal spring on each channel, in the rig file's order [C]."""
        return tuple(float(x) for x in self._state.temperature[: len(self._column)])

    def allow(self, at: float, lengths: Mapping[int, float], announced: Mapping[int, float]) -> None:
        """Raise `LimitError` if pulses at `at` break a limit. `announced`: ends of earlier pulses [s]."""
        most = limits.longest_pulse(self._rig)
        rests = self._rig.limits
        for channel, seconds in lengths.items():
            if channel not in self._column:
                raise LimitError(
                    f"channel {channel} heats no spring",
                    expected=f"one of {sorted(self._column)}",
                    remedy="see the rig file's channels",
                )
            if not 0 < seconds <= most + 1e-6:
                raise LimitError(
                    f"a pulse of channel {channel} is too long",
                    expected=f"at most {most:g} s",
                    found=f"{seconds:g} s",
                )
            opened = max(self._opened_at.get(channel, -np.inf), announced.get(channel, -np.inf))
            if at - opened < rests.least_off_s - _SLACK:
                raise LimitError(
                    f"channel {channel} has too little time to cool",
                    expected=f"at least {rests.least_off_s:g} s",
                    found=f"{max(at - opened, 0):.2f} s",
                )
            on = self._on_time(channel, at - _WINDOW + seconds, at) + seconds
            if on > rests.duty * _WINDOW + _SLACK and on > most + _SLACK:
                raise LimitError(
                    f"channel {channel} heats too large a part of the time",
                    expected=f"at most {rests.duty:g} of {_WINDOW:g} s",
                    found=f"{on:.1f} s",
                )
        self._check_heat(lengths)
        self.check_together({*lengths, *(c for c, until in announced.items() if until > at + _SLACK)})

    def check_together(self, channels: set[int]) -> None:
        """Raise `LimitError` for more current than the supply or the contacts may carry."""
        limits.check_current(self._rig, len(channels & set(self._column)))

    def _check_heat(self, lengths: Mapping[int, float]) -> None:
        """Check that the ceiling holds even if these contacts weld now or this computer dies."""
        longest = max(max(lengths.values()) + limits.STEP, self._rig.cutoff_s or 0.0)
        closed = [c in lengths for c in range(1, self._rig.board.channels + 1)]
        on = np.tile(self._row(closed, []), (int(np.ceil(longest / _MODEL_STEP)), 1))
        peak = float(self._model.run(on, _MODEL_STEP, self._state).temperature.max())
        if peak > self._rig.limits.ceiling_c:
            raise LimitError(
                "a spring would get too hot by the model",
                expected=f"at most {self._rig.limits.ceiling_c:g} C",
                found=f"{peak:.1f} C",
                remedy="let it cool, or heat it for a shorter time",
            )

    def switched(self, changes: Mapping[int, bool], now: float) -> None:
        """Record that commands to close or open channels were just sent."""
        self._model_to(now, self._believed, self._believed)
        for channel, on in changes.items():
            if on:
                self._closed_since.setdefault(channel, now)
            elif (since := self._closed_since.pop(channel, None)) is not None:
                self._opened_at[channel] = now
                self._spent.append((channel, since, now))
        while self._spent and self._spent[0][2] < now - _WINDOW:
            self._spent.popleft()
        # What was opened counts as open from here if the next report says so.
        self._believed = tuple(
            state and changes.get(channel, True) for channel, state in enumerate(self._believed, start=1)
        )

    def reported(self, closed: tuple[bool, ...], now: float) -> None:
        """The board's report: a contact counts as closed since the last one if either says so."""
        pairs = list(zip(self._believed, closed, strict=True))
        self._model_to(now, [a or b for a, b in pairs], [a and b for a, b in pairs])
        self._believed = closed

    def check(self, now: float) -> None:
        """Raise where a spring is too hot, or a channel has been closed for too long."""
        hot = int(self._state.temperature.argmax())
        ceiling = self._rig.limits.ceiling_c
        if self._state.temperature[hot] > ceiling:
            channel = self._rig.channels[hot % len(self._column)].channel
            raise LimitError(
                f"the spring on channel {channel} is too hot by the model",
                expected=f"at most {ceiling:g} C",
                found=f"{self._state.temperature[hot]:.1f} C",
            )
        most = limits.longest_pulse(self._rig)
        for channel, since in self._closed_since.items():
            if channel in self._column and now - since > most + limits.STEP:
                raise LimitError(
                    f"channel {channel} was closed for too long",
                    expected=f"at most {most:g} s",
                    found=f"{now - since:.1f} s",
                )

    def _on_time(self, channel: int, begin: float, end: float) -> float:
        spans = [(a, b) for c, a, b in self._spent if c == channel]
        if channel in self._closed_since:
            spans.append((self._closed_since[channel], end))
        return sum(max(0.0, min(b, end) - max(a, begin)) for a, b in spans)

    def _model_to(self, now: float, closed: Sequence[bool], surely: Sequence[bool]) -> None:
        """`surely`: closed channels that take their part of a shared supply for the whole time."""
        elapsed = now - self._modelled_to
        if elapsed <= 0:
            return
        row = self._row(closed, surely)
        steps = int(np.ceil(elapsed / (_MODEL_STEP if row.any() else _COOLING_STEP)))
        history = self._model.run(np.tile(row, (steps, 1)), elapsed / steps, self._state)
        self._state = history.final
        self.hottest = max(self.hottest, float(history.temperature[:, : len(self._column)].max()))
        self._modelled_to = now

    def _row(self, closed: Sequence[bool], surely: Sequence[bool]) -> FloatArray:
        """How strongly each modelled spring is heated."""
        heated = np.array([closed[c] for c in self._indices], dtype=np.float64)
        nominal, worst = self._parts
        sharing = max(1, sum(surely[c] for c in self._indices if c < len(surely)))
        welded = [heated.max()] if self._rig.master_channel is not None else []
        return np.concatenate([heated * nominal[int(heated.sum())], heated * worst[sharing], welded])
