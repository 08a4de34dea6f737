"""Limits that hold while heating: on-times, rests, duty, current and modelled temperature."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from eldir.built.heat import HeatModel, SpringState
from eldir.core.records import FloatArray
from eldir_hardware.guardian.forecast import HORIZON, MOST, Forecast, Heating, together
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety import limits
from eldir_hardware.safety.limits import LimitError
from eldir_hardware.safety.spring_memory import SpringHeat, Springs, heat_of, joined

_MODEL_STEP = 0.1  # while something heats [s]
_COOL = 2.0  # above the air, where a schedule begins that was checked from cold springs [K]
_SLACK = 0.05  # contacts do not move to the millisecond [s]


class Interlock:
    """Follows the board's reports. Springs in the worst corner of the tolerances are modelled too."""

    def __init__(self, rig: Rig, now: float, before: Springs | None = None):
        """`before`: what is known of the springs from the run before; None if all are cold."""
        limits.check_rig(rig)
        self._rig = rig
        self._column = {c.channel: i for i, c in enumerate(rig.channels)}
        self._places = {c.channel: (c.spring, c.face) for c in rig.channels}
        self._indices = [c.channel - 1 for c in rig.channels]
        count = len(rig.channels)
        worst = limits.worst_springs(rig)
        # A contact welded behind a contactor is not seen: its spring heats whenever any does.
        welded = [worst] if rig.master_channel is not None else []
        nominal = rig.spring_parameters()
        self._springs = [nominal] * count + [worst] * count + welded
        self._model = HeatModel(self._springs)
        self._state = SpringState(
            np.array([nominal.ambient] * count + [worst.ambient] * (count + len(welded))),
            np.ones(2 * count + len(welded)),
        )
        self._forecast = Forecast(rig)
        self._parts = limits.shares(rig, nominal), limits.shares(rig, worst, worst=True)
        self._modelled_to = now
        self._believed = (False,) * rig.board.channels
        self._closed_since: dict[int, float] = {}
        self._opened_at: dict[int, float] = {}
        self._spent: deque[tuple[int, float, float]] = deque()  # channel, closed, opened
        self.hottest = nominal.ambient
        """Highest modelled temperature so far of the nominal springs [C]."""
        self._only_cools = False
        """Whether nothing has been heated since the run before."""
        self._others: dict[int, SpringHeat] = {}
        self._began = now
        if before:
            self._only_cools = True
            self._recall(before, now)

    def _recall(self, before: Springs, now: float) -> None:
        """Begin with the springs as they were, and let them cool until `now`, without a fan: it was off."""
        count = len(self._column)
        pair = [replace(self._springs[i], fan=False) for i in (0, count)]  # nominal, and hottest
        still, ambient = HeatModel(pair), np.array([p.ambient for p in pair])
        temperature, martensite = self._state.temperature.copy(), self._state.martensite.copy()
        self._others = {c: heat for c, heat in before.items() if c not in self._column}  # of another rig file
        for channel, column in self._column.items():
            found = heat_of(before, channel, self._places[channel])
            begun = [SpringState(np.maximum(h.temperature_c, ambient), np.array(h.martensite)) for h in found]
            cooled = [still.cool(state, h.age_s) for state, h in zip(begun, found, strict=True)]
            columns = [column, column + count]
            for state in cooled:
                temperature[columns] = np.maximum(temperature[columns], state.temperature)
                martensite[columns] = np.minimum(martensite[columns], state.martensite)
            spans = [(now - h.age_s - begin, now - h.age_s - end) for h in found for begin, end in h.pulses_s]
            self._spent += [(channel, closed, opened) for closed, opened in joined(spans)]
            if spans:
                self._opened_at[channel] = max(opened for _, opened in spans)
        if self._rig.master_channel is not None:
            hottest = int(temperature[count : 2 * count].argmax()) + count
            temperature[-1], martensite[-1] = temperature[hottest], martensite[hottest]
        self._spent = deque(sorted(self._spent, key=lambda spent: spent[2]))
        self._state = SpringState(temperature, martensite)

    def heat_left(self, now: float) -> dict[int, SpringHeat]:
        """The springs by channel, for the next run, those of other rig files too.

        Every contact must have been seen open.
        """
        self._model_to(now, self._believed, self._believed)
        count = len(self._column)
        t, xi = self._state.temperature, self._state.martensite
        own = {
            channel: SpringHeat(
                (float(t[column]), float(t[column + count])),
                (float(xi[column]), float(xi[column + count])),
                tuple((now - begin, now - end) for c, begin, end in self._spent if c == channel),
                place=self._places[channel],
            )
            for channel, column in self._column.items()
        }
        return {channel: heat.after(now - self._began) for channel, heat in self._others.items()} | own

    def rest_left(self, now: float) -> float:
        """For how long a run should wait, so that its springs begin rested and cool [s]."""
        self._model_to(now, self._believed, self._believed)
        least = self._rig.limits.min_off_s
        rest = max((at + least - now for at in self._opened_at.values()), default=0.0)
        rest = max([rest, *(self._duty_time(channel, now) for channel in self._column)])
        return max(rest, self._cooling_time(), 0.0)

    def _duty_time(self, channel: int, now: float) -> float:
        """Until half of the duty is free again [s]: the schedule that follows has up to all of it."""
        most = self._rig.limits.duty * limits.WINDOW / 2
        spans = [(a, b) for c, a, b in self._spent if c == channel]
        for wait in np.arange(0.0, limits.WINDOW + 1.0):
            since = now + wait - limits.WINDOW
            if sum(max(b - max(a, since), 0.0) for a, b in spans) <= most:
                break
        return float(wait)

    def _cooling_time(self) -> float:
        """Until each spring is near the air, if nothing heats [s]."""
        return float(self._model.cooling_time(self._state, _COOL).max())

    @property
    def temperatures(self) -> tuple[float, ...]:
        """Temperature of the nominal spring on each channel, in the rig file's order [C]."""
        return tuple(float(x) for x in self._state.temperature[: len(self._column)])

    def allow(self, at: float, lengths: Mapping[int, float], heating: Sequence[Heating] = ()) -> None:
        """Raise `LimitError` if pulses at `at` break a limit, together with what is closed or announced.

        `heating`: the channels that are closed, and the announced pulses.
        """
        self._check_lengths(at, lengths)
        new = [Heating(at, channel, at + seconds) for channel, seconds in lengths.items()]
        if (count := len(heating) + len(new)) > MOST:
            raise LimitError(
                "too many pulses are announced",
                code="limit.announced",
                expected=f"at most {MOST}",
                found=str(count),
                remedy="announce each pulse shortly before it begins",
            )
        for pulse in new:
            self._check_rest_and_duty(pulse, [p for p in heating if p.channel == pulse.channel])
        every = [*heating, *new]
        for channels in together(every, _SLACK).values():
            self.check_together(channels)
        self._check_heat(every)

    def check_together(self, channels: set[int]) -> None:
        """Raise `LimitError` for more current than the supply or the contacts may carry."""
        limits.check_current(self._rig, len(channels & set(self._column)))

    def _check_lengths(self, at: float, lengths: Mapping[int, float]) -> None:
        most = limits.longest_pulse(self._rig)
        for channel, seconds in lengths.items():
            if channel not in self._column:
                raise LimitError(
                    f"channel {channel} heats no spring",
                    code="limit.other-wiring",
                    expected=f"one of {sorted(self._column)}",
                    remedy="see the rig file's channels",
                )
            if not 0 < seconds <= most + 1e-6:
                raise limits.too_long(f"a pulse of channel {channel} is too long", self._rig, seconds)
            if not (ahead := at + seconds - self._modelled_to) <= HORIZON:  # also where `at` is no number
                raise LimitError(
                    f"a pulse of channel {channel} is announced too far ahead",
                    code="limit.announced",
                    expected=f"its end within {HORIZON:g} s",
                    found=f"in {ahead:.1f} s",
                    remedy="announce each pulse shortly before it begins",
                )

    def _check_rest_and_duty(self, new: Heating, others: Sequence[Heating]) -> None:
        """`others`: what else is closed or announced on this channel."""
        allowed, channel = self._rig.limits, new.channel
        spent = [(a, b) for c, a, b in self._spent if c == channel]
        spans = [*spent, *((p.begin, p.end) for p in others)]
        for begin, end in [(-np.inf, self._opened_at.get(channel, -np.inf)), *spans]:
            rest = max(new.begin - end, begin - new.end)
            if rest < allowed.min_off_s - _SLACK:
                remedy = "begin a run when the springs have rested from the one before"
                raise limits.no_rest(channel, self._rig, f"{max(rest, 0):.2f} s", remedy)
        on = limits.most_on([*spans, (new.begin, new.end)])
        if on > allowed.duty * limits.WINDOW + _SLACK:
            raise limits.beyond_duty(channel, self._rig, f"{on:.1f} s")

    def _check_heat(self, pulses: Sequence[Heating]) -> None:
        """Check that the ceiling holds to the end of all pulses, also if a contact welds."""
        count = len(self._column)
        worst = SpringState(self._state.temperature[count:], self._state.martensite[count:])
        peak = self._forecast.peak(self._modelled_to, worst, pulses)
        if peak > self._rig.limits.max_temperature_c:
            problem, remedy = "a spring would get too hot", "let it cool, or heat it for a shorter time"
            raise limits.too_hot(f"{problem} by the model", self._rig, f"{peak:.1f} C", remedy)

    def switched(self, changes: Mapping[int, bool], now: float) -> None:
        """Record that commands to close or open channels were just sent."""
        # What was closed since the last report counts as closed: it may be opened before the next one.
        closed = [state or c in self._closed_since for c, state in enumerate(self._believed, start=1)]
        self._model_to(now, closed, self._believed)
        for channel, on in changes.items():
            if on:
                if self._only_cools:  # what the run before left is no peak of this one
                    self._only_cools, self.hottest = False, max(self.temperatures)
                self._closed_since.setdefault(channel, now)
            elif (since := self._closed_since.pop(channel, None)) is not None:
                self._opened_at[channel] = now
                self._spent.append((channel, since, now))
        while self._spent and self._spent[0][2] < now - limits.WINDOW:
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
        ceiling = self._rig.limits.max_temperature_c
        left_hot = self._only_cools and not any(self._believed)  # by a run with a higher ceiling
        if self._state.temperature[hot] > ceiling and not left_hot:
            channel = self._rig.channels[hot % len(self._column)].channel
            problem, found = "is too hot by the model", f"{self._state.temperature[hot]:.1f} C"
            raise limits.too_hot(f"the spring on channel {channel} {problem}", self._rig, found)
        most = limits.longest_pulse(self._rig)
        for channel, since in self._closed_since.items():
            if channel in self._column and now - since > most + limits.STEP:
                problem = f"channel {channel} was closed for too long"
                raise limits.too_long(problem, self._rig, round(now - since, 1))

    def _model_to(self, now: float, closed: Sequence[bool], surely: Sequence[bool]) -> None:
        """`surely`: closed channels that take their part of a shared supply for the whole time."""
        elapsed = now - self._modelled_to
        if elapsed <= 0:
            return
        row = self._row(closed, surely)
        self._modelled_to = now
        if not row.any():
            self._state = self._model.cool(self._state, elapsed)
            return
        steps = int(np.ceil(elapsed / _MODEL_STEP))
        history = self._model.run(np.tile(row, (steps, 1)), elapsed / steps, self._state)
        self._state = history.final
        self.hottest = max(self.hottest, float(history.temperature[:, : len(self._column)].max()))

    def _row(self, closed: Sequence[bool], surely: Sequence[bool]) -> FloatArray:
        """How strongly each modelled spring is heated."""
        heated = np.array([closed[c] for c in self._indices], dtype=np.float64)
        nominal, worst = self._parts
        sharing = max(1, sum(surely[c] for c in self._indices if c < len(surely)))
        welded = [heated.max()] if self._rig.master_channel is not None else []
        return np.concatenate([heated * nominal[int(heated.sum())], heated * worst[sharing], welded])
