"""Mutation tests: small faults are put into a copy of the code, one at a time, and the tests must fail.

`python -m tests.stress.mutation --help`. Nothing in the working tree is changed.
"""
