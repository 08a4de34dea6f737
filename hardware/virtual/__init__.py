"""The virtual rig: emulated board, thermal springs and body, driven through the real relay driver."""
