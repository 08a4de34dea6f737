"""Run by CPython and by MicroPython: a recorded trace through the firmware, flat as on the board.

Arguments: the firmware's folder, the trace. Its lines: tick, and a line from the host in hexadecimal, `-`
where only time passed, or `!` and the token at a reset. Printed: answer, powers, gates, and when the next
thing is due.
"""

import binascii
import sys

sys.path.insert(0, sys.argv[1])

from channel_limits import POWER_UP, ChannelLimits, Modulation
from protocol import RequestHandler

settings, limits, conversation, modulation = (), None, None, None
with open(sys.argv[2]) as trace:
    for line in trace:
        words = line.split()
        tick, event, answer = int(words[0]), words[1], b""
        if event == "!":
            channels, longest, duty, heartbeat, steady, token = [int(word) for word in words[2:]]
            limits = ChannelLimits(channels, longest, duty, heartbeat, (steady,), tick, POWER_UP)
            conversation, modulation = RequestHandler(limits, token), Modulation(channels, 100, tick)
        elif event == "-":
            limits.step(tick)
        else:
            answer = conversation.answer(binascii.unhexlify(event[1:]), tick)
        print(
            answer,
            limits.power,
            limits.off_reason,
            modulation.update(limits.power, tick),
            limits.next_event_ms(),
        )
