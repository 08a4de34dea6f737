"""Command line of the mutation tests.

python -m tests.stress.mutation --only interlock --results mutants.json
python -m tests.stress.mutation --workers 4 --results mutants.json --table docs/safety-mutants.md
"""

from __future__ import annotations

import argparse
from pathlib import Path

from tests.stress.mutation.campaign import Campaign


def main() -> None:
    """Run a campaign and print those that survive."""
    options = argparse.ArgumentParser(prog="python -m tests.stress.mutation", description=__doc__)
    options.add_argument("--only", nargs="*", default=[""], help="parts of the modules' paths")
    options.add_argument("--workers", type=int, default=1, help="processes")
    options.add_argument("--sample", type=int, help="so many mutants only, drawn by --seed")
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--results", type=Path, help="JSON file; those killed in it are not run again")
    options.add_argument("--measured", type=Path, help="JSON file: which test runs what, made where it lacks")
    options.add_argument("--table", type=Path, help="Markdown file to write")
    options.add_argument("--all", action="store_true", help="run the equivalent ones too")
    options.add_argument("--list", action="store_true", help="show the mutants and run none")
    given = options.parse_args()
    campaign = Campaign(given.only, given.sample, given.seed, given.measured)
    if given.list:
        print(*campaign.mutants, sep="\n")
        return
    results = campaign.run(given.workers, given.results, equivalent_too=given.all)
    for mutant in results.unexplained:
        print("SURVIVED", mutant)
    for mutant in results.wrongly_explained:
        print("KILLED, but listed as equivalent", mutant)
    print(results.table())
    if given.table:
        given.table.write_text(results.page())


if __name__ == "__main__":
    main()
