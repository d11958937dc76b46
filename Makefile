# Everything runs in .venv, which the first target creates. Requirements: make and Python 3.11 or newer.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
QUICK ?= --quick
PARTS ?= calls fit reading
CONSTRAINTS ?= constraints.txt
# Rooms whose arrays are checked against their annotations in the full form of the tests.
TYPED := batch control data fitting identify inference models params sampling stage uncertainty
EVERY_SHAPE = --jaxtyping-packages=$(subst $() $(),,$(foreach room,$(TYPED),hystfit.$(room),))beartype.beartype
# Tests and experiments compile the same programs in many processes: they share one compilation cache.
export JAX_COMPILATION_CACHE_DIR ?= $(CURDIR)/build/programs
export JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS ?= 0.1
# A cache with a maximum size reads all its entries before it adds one (60 ms at 1700 entries), so `setup` removes old entries instead.
export JAX_COMPILATION_CACHE_MAX_SIZE ?= -1
# Hundreds of tests and all experiments start processes: each would compile the sources of hystfit again.
export PYTHONDONTWRITEBYTECODE :=
# Two processes run on two cores, so linear algebra uses one thread each.
export OPENBLAS_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: help setup fit test quick lint types tests hard notebooks experiments mutations measured benchmarks smoke docs package records versions release-check clean

help:  ## this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 14

# uv installs in less than half of the processor time of pip, which is used where uv does not reach the packages (it reads no pip.conf).
DEVELOPMENT = --quiet --constraint $(CONSTRAINTS) --editable '.[dev]'
$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip 'uv>=0.8'
	$(BIN)/uv pip install --compile-bytecode --python $(BIN)/python $(DEVELOPMENT) || $(BIN)/python -m pip install $(DEVELOPMENT)
	touch $@

setup: $(VENV)/.installed  ## create .venv with hystfit and all test dependencies
	@find build/programs -type f -mtime +7 -delete 2>/dev/null || true

fit: setup  ## fit a bundled record and print the report
	$(BIN)/hystfit fit stage-sweep --out fit

# The tests run in two processes. What follows them uses one core each, two at a time, and goes on after a failure.
test: lint  ## all checks, in the quick form
	$(MAKE) tests
	@rm -f build/experiments/*.log
	$(MAKE) --keep-going --output-sync -j 2 types $(EXPERIMENTS:%=experiment-%) $(NOTEBOOKS:%=notebook-%) package smoke

quick: lint  ## while working: lint, types and tests of the files changed since BASE (main where it is an ancestor, else HEAD)
	$(BIN)/python -m tests.touched $(BASE)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache

types: setup
	$(BIN)/pyrefly check --min-severity error

tests: setup  ## the tests, without the slow ones (QUICK= for all)
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --max-worker-restart 1 -q $(if $(QUICK),-m "not slow",$(EVERY_SHAPE))

# What takes longest starts first, so that both cores are busy to the end.
NOTEBOOKS := 04_uncertainty_study 03_creep_and_the_filter 01_first_fit
NOTEBOOKS += $(filter-out $(NOTEBOOKS),$(basename $(notdir $(wildcard notebooks/[0-9]*.py))))
EXPERIMENTS := preisach ukf uncertainty measured magnetics recognition duhem structures
EXPERIMENTS += $(filter-out $(EXPERIMENTS),$(patsubst experiments/%/run.py,%,$(wildcard experiments/*/run.py)))

notebooks: setup  ## run every notebook, two at a time (QUICK= for the full form)
	@$(MAKE) --keep-going --output-sync -j 2 $(NOTEBOOKS:%=notebook-%)

$(NOTEBOOKS:%=notebook-%): notebook-%: setup
	@$(BIN)/python notebooks/run.py $(QUICK) $*

experiments: setup  ## run every experiment, two at a time, and check its numbers (QUICK= for the full form)
	@rm -f build/experiments/*.log
	@$(MAKE) --keep-going --output-sync -j 2 $(EXPERIMENTS:%=experiment-%); status=$$?; \
	  grep -E "^(ok|missed|skipped): |^  (missed|skipped): |^exit status [1-9]" build/experiments/*.log; exit $$status

# The quick form compiles for little processor time; programs of the experiments named here run longer than they compile.
OPTIMIZED := preisach
FAST = $(if $(QUICK),-m tests.fast $(if $(filter $(OPTIMIZED),$*),--optimized))
# Exit status of an experiment: 0 ok, 1 a number missed, 77 parts skipped without their measured data (experiments/common.py).
$(EXPERIMENTS:%=experiment-%): experiment-%: setup
	@mkdir -p build/experiments
	@log=build/experiments/$*.log; $(BIN)/python $(FAST) experiments/$*/run.py $(QUICK) > $$log 2>&1; status=$$?; \
	  echo "exit status $$status" >> $$log; echo "== $*"; cat $$log; test $$status -eq 77 || exit $$status

mutations: setup  ## put faults into library and surrogates, and check that each makes an experiment (experiments/MUTATIONS.md) or a test fail
	$(BIN)/python experiments/mutations.py
	$(BIN)/python -m tests.hard.library_faults

hard: setup  ## generated and damaged data files, 100 000 of each, 20 000 layouts of instruments, damaged fits, killed saves, full disks, interrupts, NIST, random devices
	$(BIN)/python -m tests.hard.reading --files 0:100000 --mutations 0:100000 --layouts 0:20000
	$(BIN)/python -m tests.hard.fits
	$(BIN)/python -m tests.hard.faults
	$(BIN)/python -m tests.hard.maps
	$(BIN)/python -m tests.hard.strd
	$(BIN)/python -m tests.hard.devices --out build/hard/devices

benchmarks: setup  ## speed beside other programs: one table of ratios, which fails below the recorded floors
	$(BIN)/python benchmarks/run.py

smoke: setup  ## the cheaper benchmarks with little work, without floors (PARTS= for all)
	$(BIN)/python benchmarks/run.py --quick $(PARTS)

docs: setup  ## build the documentation in build/docs/site; DOCS=--quick without running notebooks and gallery, DOCS=--download with measured loops
	$(BIN)/python docs/build.py $(DOCS)

package: setup  ## build the wheel and check that its data are found without the checkout
	rm -rf build/wheel && mkdir -p build/wheel/site
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir build/wheel .
	$(BIN)/python -m pip install --quiet --no-deps --target build/wheel/site build/wheel/hystfit_jax-*.whl
	cd build/wheel && PYTHONPATH=site ../../$(BIN)/python -c "import hystfit, pathlib; \
	  assert pathlib.Path(hystfit.__file__).is_relative_to(pathlib.Path('site').resolve()), hystfit.__file__; \
	  print('wheel:', len(hystfit.datasets.load('stage-sine')), 'samples of stage-sine')"

# Tests that touch every dependency. The oldest Python with the oldest versions that pyproject.toml declares, newer ones with the newest.
VERSIONED := tests/test_versions.py tests/test_saved_fits.py tests/test_bouc_wen.py tests/test_params.py
versions: setup  ## a selection of tests under each available Python from 3.11 to 3.14, with the oldest and the newest dependencies
	@status=0; for case in "3.11 lowest-direct" "3.12 highest" "3.13 highest" "3.14 highest"; do set -- $$case; \
	  found=$$(PATH=$$(printf '%s:' "$${PYENV_ROOT:-$$HOME/.pyenv}"/versions/$$1.*/bin)$$PATH \
	    UV_PYTHON_DOWNLOADS=never $(BIN)/uv python find $$1 2>/dev/null) || { echo "skipped: no Python $$1 on this machine"; continue; }; \
	  echo "== Python $$1, $$2"; env=build/versions/$$1; \
	  $(BIN)/uv venv --quiet --clear --python $$found $$env && \
	  $(BIN)/uv pip install --quiet --resolution $$2 --python $$env/bin/python --editable '.[bayes,files,frames]' \
	    'pytest>=9.0' 'pytest-timeout>=2.4' 'beartype>=0.22' 'hypothesis>=6.130' && \
	  $$env/bin/python -m pytest -q -o filterwarnings=default -m "not slow" $(VERSIONED) || status=1; done; exit $$status

release-check: setup  ## version, archives (built twice, bit for bit), metadata and first fits in new environments, from a clean clone
	$(BIN)/python -m tests.hard.release

records: setup  ## rewrite the bundled records
	$(BIN)/python data/make.py

clean:  ## remove everything that was built
	rm -rf $(VENV) build fit
