"""Emulated relay boards on pseudo-terminals; they share no encoding with the drivers."""
