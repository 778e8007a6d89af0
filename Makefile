# make run   sets up and runs the whole system end to end on the embedded garage
# make test  sets up and runs the tests
# make help  lists the rest
PYTHON ?= python3
VENV ?= .venv
MINUTES ?= 2
JOBS ?= 2
BIN := $(VENV)/bin
export OMP_NUM_THREADS ?= 2

.PHONY: help run test test-slow lint typecheck docs setup clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/'

# torch goes first and alone, so that no other package chooses its build.
$(BIN)/.ready: setup.py pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install -q "torch==$$(sed -n 's/^torch==//p' constraints.txt)"
	$(BIN)/pip install -q -e ".[test,gym]" -c constraints.txt
	touch $@

setup: $(BIN)/.ready  ## a virtual environment with everything in it

run: setup  ## data, benchmark, bytes, driving, a short training; leaves output/tour/index.html
	$(BIN)/python tools/tour.py --train_minutes $(MINUTES)

# One thread for each of the processes; a file's tests stay together, because they share what they made.
test: setup  ## the daily tests, in JOBS processes (default: 2; 0: in this one)
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist loadfile

test-slow: setup  ## the tests on demand
	$(BIN)/python -m pytest -m slow

lint: setup  ## ruff
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

typecheck: setup  ## mypy on structures, link, evaluation, datasets, registration and deploy
	$(BIN)/mypy

# The variable silences the end-of-life notice of mkdocs-material, which is no warning about these pages.
docs: setup  ## the documentation as a site in output/site; any warning fails
	$(BIN)/pip install -q -e ".[docs]" -c constraints.txt
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

clean:  ## remove the environment; data and output stay
	rm -rf $(VENV)
