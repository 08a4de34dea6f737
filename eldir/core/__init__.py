"""What every room uses: records, files, pictures, worker processes, the digest of the source.

Nothing here knows of robots.
"""
