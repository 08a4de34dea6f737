"""Pictures as bytes and files: codecs, video, the drawn body.

Markers in pictures are found in `eldir_hardware.markers`.
"""
