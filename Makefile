# make run   sets up and runs the main job end to end on the embedded garage
# make test  sets up and runs the tests
# make help  lists the rest
PYTHON ?= python3
VENV ?= .venv
CFG ?= cfgs/avp/cp_small.yaml
# The short run of `make run`: a quarter of the small data set, a few minutes of training.
SHORT := DATA_CONFIG.DATA_PATH data/avp_short DATA_CONFIG.GENERATE.SCENES 60
MINUTES ?= 5
BIN := $(VENV)/bin
export OMP_NUM_THREADS ?= 2

.PHONY: help run test test-slow lint setup clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/'

# torch goes first and alone, so that no other package chooses its build.
$(BIN)/.ready: setup.py constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install -q "torch==$$(sed -n 's/^torch==//p' constraints.txt)"
	$(BIN)/pip install -q -e ".[test,gym]" -c constraints.txt
	touch $@

setup: $(BIN)/.ready  ## a virtual environment with everything in it

run: setup  ## data set with pictures, short training, benchmark: about a quarter of an hour on two cores
	$(BIN)/python tools/create_data.py --cfg $(CFG) --preview 6 --set $(SHORT)
	$(BIN)/python tools/train.py --cfg $(CFG) --extra_tag short --max_minutes $(MINUTES) --set $(SHORT)

test: setup  ## the daily tests
	$(BIN)/python -m pytest

test-slow: setup  ## the tests on demand
	$(BIN)/python -m pytest -m slow

lint: setup  ## ruff
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

clean:  ## remove the environment; data and output stay
	rm -rf $(VENV)
