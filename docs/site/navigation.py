"""What the left side of the site lists; not in the pages, because a forge shows those as they are."""

from collections.abc import Iterable

import python_pages

# Under each page: captions, and the pages in their order.
_BELOW: dict[str, dict[str, list[str]]] = {
    "index": {
        "Start": ["installation", "tutorial", "examples", "safety"],
        "How to": [
            "how-to/simulate",
            "how-to/own-loss",
            "how-to/own-problem",
            "how-to/printer",
            "how-to/board-and-camera",
            "how-to/identify",
            "how-to/adapt",
            "how-to/ros",
            "how-to/add-a-board",
            "how-to/see-the-frames",
        ],
        "Explanation": [
            "explanation/physics",
            "explanation/heat",
            "explanation/evidence",
            "explanation/open-problems",
            "explanation/pretraining",
            "decisions/index",
        ],
        "Reference": [
            "reference/commands",
            "reference/python",
            "reference/files",
            "reference/errors",
            "reference/simulation",
            "reference/printing",
            "reference/rig-and-camera",
            "reference/ros",
        ],
        "The project": [
            "benchmarks",
            "other-programs",
            "evolution-runs",
            "reference/safety-measured",
            "safety-mutants",
            "developing",
            "contributing",
            "security",
            "changelog",
        ],
    },
    "reference/simulation": {
        "": [f"reference/{p}" for p in ("engine", "accuracy", "evolution", "cluster")],
    },
    "reference/printing": {
        "": [
            f"reference/{p}"
            for p in (
                "evolving-for-building",
                "built",
                "second-physics",
                "second-physics-measured",
                "packet",
                "dynamics",
                "dynamics-measured",
            )
        ],
    },
    "reference/rig-and-camera": {
        "": [
            "reference/rig",
            "reference/boards",
            "reference/test-doubles",
            "reference/watch",
            "reference/mosfet-board",
            "reference/sensor",
            "reference/camera",
            "reference/vision",
            "reference/log",
            "reference/runs",
            "reference/report",
        ],
    },
    "reference/ros": {"": ["reference/ros2", "reference/ros-interface", "ros2", "ros2-nodes"]},
    "reference/commands": {"": ["generated/commands/*"]},
    "reference/files": {"": ["generated/formats/*"]},
    "reference/python": {"": [f"generated/python/{module}" for module in python_pages.MODULES]},
    "decisions/index": {"": ["decisions/0*"]},
}


def below(page: str) -> str:
    """The lists of pages that stand under `page`, as Markdown for Sphinx; empty for most pages."""
    return "".join(_toctree(caption, pages) for caption, pages in _BELOW.get(page, {}).items())


def _toctree(caption: str, pages: Iterable[str]) -> str:
    options = [":hidden:", ":maxdepth: 1", ":glob:", *([f":caption: {caption}"] if caption else [])]
    return "\n\n```{toctree}\n" + "\n".join([*options, "", *(f"/{page}" for page in pages)]) + "\n```\n"
