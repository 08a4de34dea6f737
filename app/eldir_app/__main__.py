"""`python -m eldir_app` is the command."""

from eldir_app.main import main

main()
