# Commands with nothing before them: `make demo`, `make test`, `make test-all` and `make docs`. Python 3.11 or newer and make are all they need.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin

.PHONY: demo test test-all lint docs bench wheel format clean

demo: $(VENV)/installed
	$(BIN)/fingerflow demo

# Two processes of one thread each: threads of torch that share cores wait for each other.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist loadscope --no-loadscope-reorder

# What is promised, once: no compiler, browser or network is needed.
test: $(VENV)/installed-dev
	$(PYTEST) -m "not long"

# The same and all the rest.
test-all: lint test
	$(PYTEST) -m long

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# -W: whatever Sphinx warns of, a broken link among it, is an error.
docs: $(VENV)/installed-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m sphinx -W --keep-going -q -d docs/site/.doctrees docs docs/site
	@echo "open docs/site/index.html"

# Builds the wheel of this platform and checks its kernels in an empty folder, beside the packages installed for the demo.
wheel: $(VENV)/installed
	rm -rf dist
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps -w dist .
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --target dist/empty dist/*.whl
	cd dist && PYTHONPATH=empty $(abspath $(BIN))/python -m fingerflow --version
	cd dist && PYTHONPATH=empty $(abspath $(BIN))/python ../tests/kernels/wheel_check.py

bench: $(VENV)/installed-dev
	$(BIN)/python -m bench

format: $(VENV)/installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "fingerflow needs Python 3.11 or newer; $$($(PYTHON) --version) was found. Try: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv $(VENV)

# The compiled kernels are part of the install: their sources count like the list of dependencies.
KERNELS := setup.py $(wildcard kernels/*.cpp kernels/*.h kernels/*.py) $(wildcard fingerflow/kernels/median_*.py)
KERNELS += $(wildcard fingerflow/kernels/declarations.py fingerflow/kernels/tracking_limits.py fingerflow/kernels/contact_sizes.py)

$(VENV)/installed: pyproject.toml constraints.txt $(KERNELS) | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(VENV)/installed-dev: pyproject.toml constraints.txt $(KERNELS) | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@ $(VENV)/installed

clean:
	rm -rf $(VENV) build dist *.egg-info fingerflow/_kernels* fingerflow-demo docs/site docs/generated
