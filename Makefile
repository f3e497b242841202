# Everything a developer or CI calls. Each target builds what it needs: only Python 3.11, make and a
# package index have to be there.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
SEED ?= 1
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --constraint constraints.txt
# Where the wheel is tried.
WHEEL := out/wheel
PINS := pyproject.toml constraints.txt

.PHONY: help demo test test-slow test-hard check docs format bench schemas wheel clean
.DELETE_ON_ERROR:

help:
	@echo "make demo       plant a hidden effect, diagnose it, compare (SEED=2 takes another); see out/demo"
	@echo "make test       the fast suite;  make test-slow: the long statistical tests"
	@echo "make test-hard  hostile input, kills, races and bombs: what docs/hardness.md promises, in small sizes"
	@echo "make check      lint, formatting, types and the site;  make format: mend the first two"
	@echo "make docs       the site in out/site, warnings as errors"
	@echo "make bench      the measured promises, printed beside their targets"
	@echo "make schemas    write schemas/ from the records"
	@echo "make wheel      build the wheel, install it in a clean environment of each Python that is here, run the quick demo"
	@echo "make clean      remove .venv, out/ and caches"

demo: $(VENV)/core.stamp
	$(BIN)/candata demo --out out/demo --seed $(SEED)

test: $(VENV)/test.stamp
	$(BIN)/python -m pytest -n auto --dist loadfile -m "not slow"

test-slow: $(VENV)/test.stamp
	$(BIN)/python -m pytest -n auto --dist loadfile -m slow

test-hard: $(VENV)/test.stamp
	$(BIN)/python -m pytest -n auto --dist loadfile -m hard
	$(BIN)/python benchmarks/kills.py --kills 42
	$(BIN)/python benchmarks/hard_models.py
	$(BIN)/python benchmarks/mutated_inputs.py --inputs 20000
	$(BIN)/python benchmarks/clean_checks.py --episodes 96
	$(BIN)/python benchmarks/silent_mistakes.py --scenes gripper_tabletop --random 1

check: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(MAKE) docs

docs: $(VENV)/dev.stamp
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet

format: $(VENV)/dev.stamp
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(VENV)/test.stamp
	@set -e; for file in benchmarks/[a-z]*.py; do echo "== $$file"; $(BIN)/python $$file; done
	$(BIN)/candata gap bench --out out/bench

schemas: $(VENV)/core.stamp
	$(BIN)/python -m candata.schema.export schemas

wheel: $(VENV)/venv.stamp
	rm -rf $(WHEEL) build
	$(BIN)/python -m pip --disable-pip-version-check wheel --no-deps --wheel-dir $(WHEEL) .
	tools/try_wheel.sh $(WHEEL)

clean:
	rm -rf $(VENV) out build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis

# A stamp stands once its install has ended well; a newer pyproject.toml or constraints.txt makes it again.
$(VENV)/venv.stamp:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "candata needs Python 3.11 or newer; set PYTHON=")'
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/core.stamp: $(PINS) | $(VENV)/venv.stamp
	$(PIP) --editable .
	@touch $@

$(VENV)/test.stamp: $(VENV)/core.stamp
	$(PIP) --editable ".[test]"
	@touch $@

$(VENV)/dev.stamp: $(VENV)/core.stamp
	$(PIP) --editable ".[test,dev,docs]"
	@touch $@
