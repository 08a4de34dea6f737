"""`python -m eldir` is the command."""

from eldir_app.main import main

main()
