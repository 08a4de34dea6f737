"""Common parts of all packages: records, files, pictures, worker processes, the digest of the source.

Nothing here knows of robots.
"""
