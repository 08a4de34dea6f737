"""The catalogue of logs: what was recorded, how it ended, and what reports and people say about it.

The logs, the reports and the notes beside the logs are the truth. The index only keeps what was read from
them, and is made again at any time.
"""
