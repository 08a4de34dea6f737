"""The `metadata.yaml` that makes the folder of a log a bag of rosbag2."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mcap.reader import SeekingReader
from mcap.records import Channel, Schema
from mcap.summary import Summary

from eldir.core.files import read_file, write_text
from eldir.core.yaml_files import dump_yaml, parse_foreign_yaml
from eldir.errors import InputError, damaged
from eldir_hardware.images.file_kind import require_log
from eldir_hardware.log import messages as m

FILE = "metadata.yaml"
_LARGEST = 1 << 20  # of a description [bytes]
_VERSION = 8
"""Version of the description that Jazzy reads; version 7 added hashes of the types, 9 changed the QoS."""


def describe(log: Path) -> Path | None:
    """Write `metadata.yaml` beside a finished log, for `ros2 bag play FOLDER`. Return None if the folder
    already describes another log, because a bag is one recording; `ros2 bag` can open the file itself."""
    path = log.parent / FILE
    if path.exists():
        return None
    with log.open("rb") as file:
        summary = SeekingReader(file).get_summary()
    assert summary is not None  # we have just finished it
    text = dump_yaml({"rosbag2_bagfile_information": _information(log.name, summary)})
    write_text(path, text)
    return path


def log_in(path: Path) -> Path:
    """The log at a path: the file itself, or the log that a bag folder describes."""
    if not path.is_dir():
        require_log(path)
        return path
    if not (path / FILE).exists():
        raise InputError(
            f"{path} is no bag folder",
            code="bag.no-metadata",
            expected=f"a log and its {FILE}",
            remedy="name the .mcap file itself",
        )
    remedy = "name the .mcap file itself"
    values = parse_foreign_yaml(read_file(path / FILE, _LARGEST), str(path / FILE), remedy)
    try:
        names = values["rosbag2_bagfile_information"]["relative_file_paths"]
    except (KeyError, TypeError) as error:
        raise damaged(path / FILE, found=type(error).__name__, remedy=remedy) from None
    if len(names) != 1:
        raise InputError(
            f"{path} holds several files", code="bag.several-files", expected="one log", found=f"{len(names)}"
        )
    log = path / Path(names[0]).name
    require_log(log)
    return log


def _information(name: str, summary: Summary) -> dict[str, Any]:
    statistics = summary.statistics
    assert statistics is not None
    count = statistics.message_count
    times = {
        "starting_time": {"nanoseconds_since_epoch": statistics.message_start_time if count else 0},
        "duration": {"nanoseconds": statistics.message_end_time - statistics.message_start_time},
        "message_count": count,
    }
    topics = [
        {
            "topic_metadata": _topic(channel, summary.schemas[channel.schema_id]),
            "message_count": statistics.channel_message_counts.get(number, 0),
        }
        for number, channel in sorted(summary.channels.items())
    ]
    return {
        "version": _VERSION,
        "storage_identifier": "mcap",
        **times,
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [name],
        "files": [{"path": name, **times}],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def _topic(channel: Channel, schema: Schema) -> dict[str, str]:
    return {
        "name": channel.topic,
        "type": schema.name,
        "serialization_format": channel.message_encoding,
        "offered_qos_profiles": channel.metadata.get("offered_qos_profiles", ""),
        "type_description_hash": m.Kind(schema.name).digest if schema.name in m.types().types else "",
    }
