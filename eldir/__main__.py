"""`python -m eldir` is the command."""

from eldir.commands.main import main

main()
