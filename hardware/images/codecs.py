"""OpenCV's readers, without their own words on the screen: what is wrong is told in our one line."""

from __future__ import annotations

import os

import cv2


def quiet() -> None:
    """Before anything is opened."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
