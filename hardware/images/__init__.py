"""Pictures as bytes and files: codecs, video, the printed sheet of marks.

What is seen in them is found in `hardware.vision`.
"""
