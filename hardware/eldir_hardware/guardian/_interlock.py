"""Limits that hold while heating: on-times, rests, duty, current and modelled temperature."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from eldir.built.heat import HeatModel, SpringState
from eldir.core.records import FloatArray
from eldir_hardware.guardian._forecast import HORIZON, MAX_PULSES, Forecast, HeatingInterval, closed_together
from eldir_hardware.guardian.measured_power import MeasuredPower
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety import limits
from eldir_hardware.safety.limits import LimitError
from eldir_hardware.safety.spring_memory import SpringHeat, Springs, merge_intervals, possible_spring_states

_MODEL_STEP = 0.1  # while something heats [s]
_COOL_DIFFERENCE = 2.0  # above the air, where a schedule begins that was checked from cold springs [K]
_TIME_TOLERANCE = 0.05  # contacts do not move to the millisecond [s]


class Interlock:
    """Models the springs by the board's reports, nominal and in the worst corner of the tolerances."""

    def __init__(self, rig: Rig, now: float, before: Springs | None = None):
        """`before`: the springs after the previous run; None if all are cold."""
        limits.check_rig(rig)
        self._rig = rig
        self._column = {c.channel: i for i, c in enumerate(rig.channels)}
        self._places = {c.channel: (c.spring, c.face) for c in rig.channels}
        self._indices = [c.channel - 1 for c in rig.channels]
        count = len(rig.channels)
        worst = limits.worst_springs(rig)
        # A contact that is welded behind a contactor cannot be detected: its spring heats whenever any does.
        welded = [worst] if rig.master_channel is not None else []
        nominal = rig.spring_parameters()
        self._springs = [nominal] * count + [worst] * count + welded
        self._fan_air = self._still_air = HeatModel(self._springs)
        if worst.fan:  # limits count on it
            self._still_air = HeatModel([replace(p, fan=False) for p in self._springs])
        self._model = self._fan_air  # cold springs do not cool
        self._state = SpringState(
            np.array([nominal.ambient] * count + [worst.ambient] * (count + len(welded))),
            np.ones(2 * count + len(welded)),
        )
        self._forecast = Forecast(rig)
        self._measured = MeasuredPower(rig)
        self._power_shares = limits.power_shares(rig, nominal), limits.power_shares(rig, worst, worst=True)
        self._modelled_to = now
        self._reported = (False,) * rig.board.channels
        self._closed_since: dict[int, float] = {}
        self._opened_at: dict[int, float] = {}
        self._pulses: deque[tuple[int, float, float]] = deque()  # channel, closed, opened
        self.peak = nominal.ambient
        """Highest modelled temperature so far of the nominal springs [C]."""
        self._no_heat_yet = False
        """Whether nothing has been heated since the previous run."""
        self._other_springs: dict[int, SpringHeat] = {}
        self._began = now
        if before:
            self._no_heat_yet = True
            self._restore(before, now)
            self._model = self._still_air

    def _restore(self, before: Springs, now: float) -> None:
        """Begin with the springs of the previous run, cooled until `now` without a fan, which was off."""
        count = len(self._column)
        pair = [replace(self._springs[i], fan=False) for i in (0, count)]  # nominal, and hottest
        still, ambient = HeatModel(pair), np.array([p.ambient for p in pair])
        temperature, martensite = self._state.temperature.copy(), self._state.martensite.copy()
        self._other_springs = {
            c: heat for c, heat in before.items() if c not in self._column
        }  # of another rig file
        for channel, column in self._column.items():
            stored = possible_spring_states(before, channel, self._places[channel])
            begun = [
                SpringState(np.maximum(h.temperature_c, ambient), np.array(h.martensite)) for h in stored
            ]
            cooled = [still.cool(state, h.age_s) for state, h in zip(begun, stored, strict=True)]
            columns = [column, column + count]
            for state in cooled:
                temperature[columns] = np.maximum(temperature[columns], state.temperature)
                martensite[columns] = np.minimum(martensite[columns], state.martensite)
            spans = [
                (now - h.age_s - begin, now - h.age_s - end) for h in stored for begin, end in h.pulses_s
            ]
            self._pulses += [(channel, closed, opened) for closed, opened in merge_intervals(spans)]
            if spans:
                self._opened_at[channel] = max(opened for _, opened in spans)
        if self._rig.master_channel is not None:
            hottest = int(temperature[count : 2 * count].argmax()) + count
            temperature[-1], martensite[-1] = temperature[hottest], martensite[hottest]
        self._pulses = deque(sorted(self._pulses, key=lambda pulse: pulse[2]))
        self._state = SpringState(temperature, martensite)

    def export_springs(self, now: float) -> dict[int, SpringHeat]:
        """The springs by channel, for the next run, including those of other rig files.

        Every contact must have been reported open.
        """
        self._advance_model(now, self._reported, self._reported)
        count = len(self._column)
        t, xi = self._state.temperature, self._state.martensite
        own = {
            channel: SpringHeat(
                (float(t[column]), float(t[column + count])),
                (float(xi[column]), float(xi[column + count])),
                tuple((now - begin, now - end) for c, begin, end in self._pulses if c == channel),
                place=self._places[channel],
            )
            for channel, column in self._column.items()
        }
        return {
            channel: heat.aged_by(now - self._began) for channel, heat in self._other_springs.items()
        } | own

    def record_fan(self, blows: bool, now: float) -> None:
        """Record that the fan blows from `now` on, or that it may stand still."""
        if self._still_air is not self._fan_air:
            self.record_switching({}, now)
            self._model = self._fan_air if blows else self._still_air

    def rest_time(self, now: float) -> float:
        """Time until the springs have rested, and cooled in the air of the fan, if there is one [s]."""
        self._advance_model(now, self._reported, self._reported)
        least = self._rig.limits.min_off_s
        rest = max((at + least - now for at in self._opened_at.values()), default=0.0)
        rest = max([rest, *(self._duty_wait(channel, now) for channel in self._column)])
        return max(rest, self._cooling_time(), 0.0)

    def _duty_wait(self, channel: int, now: float) -> float:
        """Time until half of the duty is free again [s]; the next schedule may use all of it."""
        most = self._rig.limits.duty * limits.DUTY_WINDOW / 2
        spans = [(a, b) for c, a, b in self._pulses if c == channel]
        for wait in np.arange(0.0, limits.DUTY_WINDOW + 1.0):
            since = now + wait - limits.DUTY_WINDOW
            if sum(max(b - max(a, since), 0.0) for a, b in spans) <= most:
                break
        return float(wait)

    def _cooling_time(self) -> float:
        """Time until each spring is near the air's temperature, if nothing heats [s]."""
        return float(self._fan_air.cooling_time(self._state, _COOL_DIFFERENCE).max())

    @property
    def temperatures(self) -> tuple[float, ...]:
        """Temperature of the nominal spring on each channel, in the rig file's order [C]."""
        return tuple(float(x) for x in self._state.temperature[: len(self._column)])

    def check_pulses(
        self, at: float, durations: Mapping[int, float], heating: Sequence[HeatingInterval] = ()
    ) -> None:
        """Raise `LimitError` if new pulses at `at` exceed a limit together with `heating`.

        `heating`: the closed channels and the announced pulses.
        """
        self._check_durations(at, durations)
        new = [HeatingInterval(at, channel, at + seconds) for channel, seconds in durations.items()]
        if (count := len(heating) + len(new)) > MAX_PULSES:
            raise LimitError(
                "too many pulses are announced",
                code="limit.announced",
                expected=f"at most {MAX_PULSES}",
                found=str(count),
                remedy="announce each pulse shortly before it begins",
            )
        for pulse in new:
            self._check_rest_and_duty(pulse, [p for p in heating if p.channel == pulse.channel])
        every = [*heating, *new]
        for channels in closed_together(every, _TIME_TOLERANCE).values():
            self.check_together(channels)
        self._check_heat(every)

    def check_together(self, channels: set[int]) -> None:
        """Raise `LimitError` if the current exceeds the rating of the supply or the contacts."""
        limits.check_current(self._rig, len(channels & set(self._column)))

    def _check_durations(self, at: float, durations: Mapping[int, float]) -> None:
        most = limits.max_pulse(self._rig)
        for channel, seconds in durations.items():
            if channel not in self._column:
                raise LimitError(
                    f"channel {channel} heats no spring",
                    code="limit.other-wiring",
                    expected=f"one of {sorted(self._column)}",
                    remedy="see the rig file's channels",
                )
            if not 0 < seconds <= most + 1e-6:
                raise limits.long_pulse_error(f"a pulse of channel {channel} is too long", self._rig, seconds)
            if not (ahead := at + seconds - self._modelled_to) <= HORIZON:  # also if `at` is NaN
                raise LimitError(
                    f"a pulse of channel {channel} is announced too far ahead",
                    code="limit.announced",
                    expected=f"its end within {HORIZON:g} s",
                    found=f"in {ahead:.1f} s",
                    remedy="announce each pulse shortly before it begins",
                )

    def _check_rest_and_duty(self, new: HeatingInterval, others: Sequence[HeatingInterval]) -> None:
        """`others`: closed or announced pulses of the same channel."""
        allowed, channel = self._rig.limits, new.channel
        pulses = [(a, b) for c, a, b in self._pulses if c == channel]
        spans = [*pulses, *((p.begin, p.end) for p in others)]
        for begin, end in [(-np.inf, self._opened_at.get(channel, -np.inf)), *spans]:
            rest = max(new.begin - end, begin - new.end)
            if rest < allowed.min_off_s - _TIME_TOLERANCE:
                remedy = "wait until the springs have rested from the previous run"
                raise limits.rest_error(channel, self._rig, f"{max(rest, 0):.2f} s", remedy)
        on = limits.max_on_time([*spans, (new.begin, new.end)])
        if on > allowed.duty * limits.DUTY_WINDOW + _TIME_TOLERANCE:
            raise limits.duty_error(channel, self._rig, f"{on:.1f} s")

    def _check_heat(self, pulses: Sequence[HeatingInterval]) -> None:
        """Check the highest temperature until the end of all pulses, also if a contact welds."""
        count = len(self._column)
        worst = SpringState(self._state.temperature[count:], self._state.martensite[count:])
        peak = self._forecast.predict_peak(self._modelled_to, worst, pulses)
        if peak > self._rig.limits.max_temperature_c:
            problem, remedy = "a spring would get too hot", "let it cool, or heat it for a shorter time"
            raise limits.temperature_error(f"{problem} by the model", self._rig, f"{peak:.1f} C", remedy)

    def record_switching(self, changes: Mapping[int, bool], now: float) -> None:
        """Record that commands to close or open channels were just sent."""
        # A contact that was closed since the last report counts as closed; it may open before the next one.
        closed = [state or c in self._closed_since for c, state in enumerate(self._reported, start=1)]
        self._advance_model(now, closed, self._reported)
        for channel, on in changes.items():
            if on:
                if self._no_heat_yet:  # the heat of the previous run is not the peak of this one
                    self._no_heat_yet, self.peak = False, max(self.temperatures)
                self._closed_since.setdefault(channel, now)
            elif (since := self._closed_since.pop(channel, None)) is not None:
                self._opened_at[channel] = now
                self._pulses.append((channel, since, now))
        while self._pulses and self._pulses[0][2] < now - limits.DUTY_WINDOW:
            self._pulses.popleft()
        # An opened contact counts as open from now on if the next report shows it open.
        self._reported = tuple(
            state and changes.get(channel, True) for channel, state in enumerate(self._reported, start=1)
        )

    def record_report(self, closed: tuple[bool, ...], now: float) -> None:
        """Record the board's report. Between two reports a contact counts as closed if either says so."""
        pairs = list(zip(self._reported, closed, strict=True))
        self._advance_model(now, [a or b for a, b in pairs], [a and b for a, b in pairs])
        self._reported = closed

    def record_currents(self, currents: Mapping[int, float]) -> None:
        """Record the measured currents of channels that heat [A]: the nominal springs follow them from now
        on. The worst corner, which limits are for, does not."""
        self._measured.update(currents)

    def check(self, now: float) -> None:
        """Raise `LimitError` if a spring is too hot, or a channel has been closed for too long."""
        hot = int(self._state.temperature.argmax())
        max_temperature = self._rig.limits.max_temperature_c
        inherited_heat = self._no_heat_yet and not any(self._reported)  # by a run with a higher limit
        if self._state.temperature[hot] > max_temperature and not inherited_heat:
            channel = self._rig.channels[hot % len(self._column)].channel
            problem, found = "is too hot by the model", f"{self._state.temperature[hot]:.1f} C"
            raise limits.temperature_error(f"the spring on channel {channel} {problem}", self._rig, found)
        most = limits.max_pulse(self._rig)
        for channel, since in self._closed_since.items():
            if channel in self._column and now - since > most + limits.TIMER_STEP:
                problem = f"channel {channel} was closed for too long"
                raise limits.long_pulse_error(problem, self._rig, round(now - since, 1))

    def _advance_model(self, now: float, closed: Sequence[bool], closed_for_sure: Sequence[bool]) -> None:
        """`closed_for_sure`: channels that take their share of a shared supply for the whole time."""
        elapsed = now - self._modelled_to
        if elapsed <= 0:
            return
        row = self._heating(closed, closed_for_sure)
        self._modelled_to = now
        if not row.any():
            self._state = self._model.cool(self._state, elapsed)
            return
        steps = int(np.ceil(elapsed / _MODEL_STEP))
        history = self._model.run(np.tile(row, (steps, 1)), elapsed / steps, self._state)
        self._state = history.final
        self.peak = max(self.peak, float(history.temperature[:, : len(self._column)].max()))

    def _heating(self, closed: Sequence[bool], closed_for_sure: Sequence[bool]) -> FloatArray:
        """Power of each modelled spring, as a part of its full power."""
        heated = np.array([closed[c] for c in self._indices], dtype=np.float64)
        nominal, worst = self._power_shares
        sharing = max(1, sum(closed_for_sure[c] for c in self._indices if c < len(closed_for_sure)))
        welded = [heated.max()] if self._rig.master_channel is not None else []
        shown = heated * nominal[int(heated.sum())] * self._measured.factors
        return np.concatenate([shown, heated * worst[sharing], welded])
