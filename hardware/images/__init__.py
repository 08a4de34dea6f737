"""Pictures as bytes and files: codecs, video, the printed sheet of marks.

Marks in pictures are found in `hardware.vision`.
"""
