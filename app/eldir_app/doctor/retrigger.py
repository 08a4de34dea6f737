"""Whether a second pulse restarts a board's timer or is ignored, measured with the heat disconnected."""

from __future__ import annotations

from eldir.errors import EldirError
from eldir_hardware.clock import Clock
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.safety.stop_signals import Stop

_PULSE, _AGAIN = 0.8, 0.4
"""A pulse, and when it is sent again [s]: it ends at 0.8 s if that is ignored, at 1.2 s if it restarts."""
_SLACK = 0.15  # of a timer that counts in 0.1 s, and of the read-back [s]


def measure_retriggerable(board: RelayBoard, clock: Clock, channel: int) -> bool:
    """Whether a second pulse restarts the timer: pulse one channel twice, measure when it opens.

    Raises `EldirError` where it is neither restarted nor ignored.
    """
    if not board.times_pulses:
        raise EldirError(
            "this board does not time pulses", code="doctor.no-timer", remedy="leave board.retriggerable out"
        )
    stop = Stop()
    with stop.caught(), board.armed(), stop.heeded():
        alone = _length(board, clock, channel, None)
        if abs(alone - _PULSE) > _SLACK:
            raise EldirError(
                "the board times a pulse wrongly",
                code="doctor.wrong-time",
                expected=f"{_PULSE:g} s",
                found=f"{alone:.2f} s",
                remedy="do not use this board for pulses",
            )
        again = _length(board, clock, channel, _AGAIN)
    for restarted, expected in ((False, _PULSE), (True, _PULSE + _AGAIN)):
        if abs(again - expected) < _SLACK:
            return restarted
    raise EldirError(
        "a second pulse neither restarts the board's timer nor is ignored",
        code="doctor.second-pulse",
        expected=f"{_PULSE:g} or {_PULSE + _AGAIN:g} s",
        found=f"{again:.2f} s",
        remedy="do not use this board for pulses",
    )


def _length(board: RelayBoard, clock: Clock, channel: int, again: float | None) -> float:
    """How long the board reports the channel closed [s]; `again`: when the second pulse is sent [s]."""
    begin = clock.now()
    board.send({channel: True}, {channel: _PULSE})
    closed_at = clock.now()
    while clock.now() - begin < _PULSE + _AGAIN + 1.0:
        if again is not None and clock.now() - begin >= again:
            board.send({channel: True}, {channel: _PULSE})
            again = None
        clock.sleep_until(clock.now() + 0.02)
        if not board.states()[channel - 1] and clock.now() - closed_at > 0.1:
            return clock.now() - closed_at
    raise EldirError(
        "the board did not open a pulse by itself",
        code="doctor.stays-closed",
        remedy="cut the supply; do not use this board for pulses",
    )
