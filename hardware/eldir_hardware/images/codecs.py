"""OpenCV's readers without their own messages; errors are reported in one line of ours."""

from __future__ import annotations

import os

import cv2


def quiet() -> None:
    """Silence OpenCV; call it before a file or a camera is opened."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
