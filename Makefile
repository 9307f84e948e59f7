# `make demo` and `make test` need Python 3.11 or newer and make; everything else is installed into .venv.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: help demo demo-small rivals boards boards-plan check-results docs test test-journeys test-slow fuzz lint format install lock dist sbom clean

help:
	@echo "make demo        render 27 frames, solve them with four solvers, write results/demo/index.html"
	@echo "make test        run the tests"
	@echo "make test-journeys  run whole programs from end to end (documented commands, killed processes, clusters), make shipped data again"
	@echo "make test-slow   run the tests that take longer"
	@echo "make fuzz        put damaged and random inputs to every reader: EXAMPLES=2000 of them to each target"
	@echo "make rivals      install what the solvers of other authors need and this machine lacks"
	@echo "make boards        run the rows of the leaderboard that are not of today's code"
	@echo "make boards-plan   only list them, with an estimate of the time"
	@echo "make check-results check that measured numbers are of the revision printed beside them"
	@echo "make docs        build the documentation, out/docs/index.html"
	@echo "make lint        ruff and mypy"
	@echo "make format      format the code"
	@echo "make lock        pin the dependencies anew (requirements.lock)"
	@echo "make dist        build wheel and source archive, out/dist; the same commit gives the same bytes"
	@echo "make sbom        write the bill of materials, out/sbom.cdx.json (CycloneDX)"
	@echo "make clean       remove .venv, the documentation, the demos and caches; other files in out/ and results/ stay"

install:
	@$(PYTHON) tools/bootstrap.py

demo: install
	@$(BIN)/skybench demo

demo-small: install
	@$(BIN)/skybench demo --scenario demo_small --frames out/demo-small --out results/demo-small

test: install
	@$(BIN)/python -m pytest -m "not slow and not journey" -n 2 --dist loadfile

test-journeys: install
	@$(BIN)/python -m pytest -m "journey and not slow" -n 2 --dist loadfile

test-slow: install
	@$(BIN)/python -m pytest -m slow

# Inputs to each target; failing ones are kept in .hypothesis and tried first the next time.
EXAMPLES ?= 2000

fuzz: install
	@SKYBENCH_FUZZ_EXAMPLES=$(EXAMPLES) $(BIN)/python -m pytest tests/fuzz

# A failure is printed and costs only its solver, whose tests skip.
rivals: install
	@$(BIN)/python tools/install_rivals.py

# Frames to solve at the same time.
JOBS ?= 2
BOARDS := bench boards --out results/leaderboard --figure docs/images/leaderboard.svg --remove-old --jobs $(JOBS)

boards: install
	@$(BIN)/skybench $(BOARDS)

boards-plan: install
	@$(BIN)/skybench $(BOARDS) --plan

check-results: install
	@$(BIN)/skybench bench stale

# The variable silences an advertisement of the theme.
docs: install
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "out/docs/index.html"

lint: install
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

format: install
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

lock:
	@$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --extra dev --extra peers --generate-hashes \
		--custom-compile-command "make lock" pyproject.toml --output-file requirements.lock

# hatchling stamps all files with one date, that of the variable SOURCE_DATE_EPOCH or one of its own.
dist: install
	@$(BIN)/python -m build --no-isolation --outdir out/dist .

sbom: install
	@$(BIN)/python tools/bill_of_materials.py out/sbom.cdx.json
	@echo "out/sbom.cdx.json"

clean:
	@rm -rf .venv out/docs out/dist out/sbom.cdx.json out/demo out/demo-small results/demo results/demo-small
	@rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@rmdir out 2>/dev/null || true
