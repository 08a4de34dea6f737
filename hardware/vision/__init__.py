"""Cameras, the marks they see, and where these are in metres."""
