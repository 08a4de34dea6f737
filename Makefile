# Every target does its own set-up in .venv; see `make help`.
.DEFAULT_GOAL := help
.PHONY: help demo test lint docs stress clean

BIN := .venv/bin
OUT ?= demo
SEED ?= 1
# The first of these that runs and is new enough.
FIND_PYTHON = for p in python3.12 python3.11 python3.13 python3; do \
	$$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' 2>/dev/null && { echo $$p; break; }; done

help: ## list the targets
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

demo: .venv/ready ## walk the whole circle on a virtual rig; OUT=folder SEED=n
	$(BIN)/eldir demo --out $(OUT) --seed $(SEED)

# Programs that hold boards wait a third of the time: three workers keep two cores busy. Quadrants loads a kernel in
# half of Taichi's time, and hundreds of programs load some: all tests run on it, those that show what depends on the
# compiler on both, in one process because each would load the same kernels. Bytecode is kept for the same reason; so is what the engine compiles.
TEST := ELDIR_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m
test: .venv/ready-for-tests ## run the tests (needs no GPU, no ROS): on Quadrants; what depends on the compiler on Taichi too
	ELDIR_COMPILER=quadrants $(TEST) tests.compile_kernels
	ELDIR_COMPILER=quadrants $(TEST) pytest -q -n 3 --dist loadgroup --no-loadscope-reorder
	$(TEST) pytest -q -m 'compiler and not stress' tests/eldir/engine

lint: .venv/ready-for-tests ## style, words, types and the import contract
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/codespell
	$(BIN)/mypy
	PYTHONPATH=ros2_nodes/eldir_ros $(BIN)/lint-imports

docs: .venv/ready-for-docs ## build the site: build/site/index.html
	$(BIN)/python -m sphinx -q -E -W --keep-going -c docs/site -d build/site-doctrees docs build/site

stress: .venv/ready-for-tests ## the long proofs, some hours
	$(BIN)/python -m pytest -q -m stress --timeout 0

clean: ## remove the virtual environment
	rm -rf .venv

.venv/ready: pyproject.toml .ci/constraints.txt
	@python="$$($(FIND_PYTHON))"; \
	[ -n "$$python" ] || { echo "eldir needs Python 3.11, 3.12 or 3.13: install one (Debian, Ubuntu: apt install python3)"; exit 1; }; \
	[ -x $(BIN)/pip ] || "$$python" -m venv .venv || { rm -rf .venv; echo "the venv module is missing: apt install python3-venv"; exit 1; }
	$(BIN)/python -m pip install -q --disable-pip-version-check -c .ci/constraints.txt -e '.[mujoco]'
	@touch $@

.venv/ready-for-tests: .venv/ready
	$(BIN)/python -m pip install -q --disable-pip-version-check -c .ci/constraints.txt -e '.[test]'
	@touch $@

.venv/ready-for-docs: .venv/ready
	$(BIN)/python -m pip install -q --disable-pip-version-check -c .ci/constraints.txt -e '.[docs]'
	@touch $@
