"""What commands share in a terminal: groups, progress, Ctrl-C, options that several have.

What a command does is decided in the packages below.
"""
