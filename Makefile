# `make demo` and `make test` need Python 3.11 to 3.13 and make, nothing else: each installs what it uses into .venv.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable
OUT ?= out/demo
# What needs a GPU is left out; on a machine that has one: make unit HERE=gpu
# What needs ROS runs wherever ROS is; where it is not, tests/conftest.py leaves it out and says so.
HERE ?= not gpu

.PHONY: demo test lint types unit verify bench clean

demo: $(VENV)/.demo
	$(BIN)/coop demo --out $(OUT)

test: lint types unit

lint: $(VENV)/.test
	$(BIN)/ruff format --check .
	$(BIN)/ruff check --quiet .

types: $(VENV)/.test
	$(BIN)/pyright --warnings

unit: $(VENV)/.test
	$(BIN)/pytest -x -q -n 2 -m "not slow and $(HERE)"

verify: $(VENV)/.test
	$(BIN)/pytest -x -q -n 2 -m "slow and $(HERE)"

bench: $(VENV)/.test
	for file in benchmarks/bench_*.py; do $(BIN)/python $$file || exit 1; done

clean:
	rm -rf $(VENV) out build dist *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' \
		|| { echo "PYTHON: got $(PYTHON), expected Python 3.11 to 3.13" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null \
		|| { echo "venv: got a Python without ensurepip, expected one with it (Debian: apt install python3-venv)" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.demo: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(INSTALL) '.[viz,log,policy,serial]'
	@touch $@

$(VENV)/.test: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(INSTALL) '.[viz,log,train,rllib,torchrl,serial,dev]'
	@touch $@ $(VENV)/.demo
