# make run        set everything up in .venv and do the main job
# make test       set everything up and run the tests
# make contract   run the tests of what every law and module must keep to
# make hard       run the tests of hostile files, foreign FMUs, full disks and killed processes
# make soak       run the tests that take too long for every day
# make lint       formatting, static checks, types
# make mutate     put small faults into the sources and count those that tests notice
# make docs       build the documentation as a site in site/, strictly, notebooks executed
# make interop    install other FMI engines in .tools and compare them with ours
# make benchmark  speed and memory, recorded, not judged

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
override IGNORED += tests/benchmarks
C_FILES := $(wildcard hesr_model/equations/*.[ch] fmu_src/c/*.c fmu_src/c/*.h tests/fmu/*.c tests/fmu/*.h tests/fmu/one_file/*.c tests/fmu/one_file/m7/*.[ch] tests/cosim/properties/*.c tests/benchmarks/*.c)

# As many test processes as cores: more threads of linear algebra would wait for each other.
test contract hard soak: export OMP_NUM_THREADS = 1

HARD := tests/fuzz tests/unit/test_cache.py tests/fmu/test_state.py tests/fmu/test_blocks.py \
  $(patsubst %,tests/cosim/test_%.py,hard_to_break full_disks hostile_archives foreign_fmus workers replay)

.PHONY: run test contract hard soak mutate lint format docs interop benchmark clean

run: $(VENV)/installed
	$(BIN)/hesr run

test: $(VENV)/installed
	$(BIN)/pytest $(IGNORED:%=--ignore=%) -n 3 --dist loadfile --no-loadscope-reorder -m "not soak"

contract: $(VENV)/installed
	$(BIN)/pytest tests/contract -n 2 --dist worksteal -m "not soak"

hard: $(VENV)/installed
	$(BIN)/pytest $(HARD) -n 2 --dist loadfile --no-loadscope-reorder -m "not soak"

soak: $(VENV)/installed
	$(BIN)/pytest $(IGNORED:%=--ignore=%) -n 2 --dist worksteal -m soak

mutate: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --editable '.[mutation]'
	$(BIN)/python tests/mutation/run.py $(MUTATE)

lint: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/clang-format --dry-run -Werror $(C_FILES)

format: $(VENV)/installed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(C_FILES)

docs: $(VENV)/installed
	$(BIN)/python -m pip install --quiet 'jax>=0.4.30'  # of one notebook; no extra has it
	$(BIN)/sphinx-build -q -W --keep-going -c docs/site . site

interop: $(VENV)/installed
	.ci/interop .tools/interop
	$(BIN)/pytest tests/interop

benchmark: $(VENV)/installed
	$(BIN)/pytest tests/benchmarks --benchmark-columns=min,median,max,rounds

$(VENV)/installed: pyproject.toml
	$(PYTHON) -c "import sys; sys.exit('HESR needs Python 3.11 or newer.' if sys.version_info < (3, 11) else 0)"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[dev,docs]'
	touch $@

clean:
	rm -rf .venv site jupyter_execute .mypy_cache .ruff_cache .pytest_cache .hypothesis .benchmarks
