# make run        install in .venv what a run needs, and do the main job
# make messages   write the sentences that users can see to messages.txt, for reading
# make near       run the tests that import a changed module within two steps; NEAR=COMMIT for
#                 all changes since a commit
# make test       install everything and run the tests for every change, in minutes
# make rest       run the tests of CI that `make test` leaves out
# make test-all   run both
# make gate       run all checks of `.ci/run` that need no further installation
# make contract   run the contract tests of all laws and modules
# make hard       run the tests of hostile files, foreign FMUs, full disks and interrupts as a
#                 background job does, with SIGINT ignored
# make kernels    run those tests of `make test` that fit laws with other kernels of OpenBLAS, which
#                 round differently
# make nightly    run the groups of tests/nightly.toml and record those that pass; GROUPS='site soak'
#                 chooses groups
# make durations  record the CPU seconds of the last `make gate` or `.ci/run`, which choose the tests
#                 of `make test`, in tests/durations.toml
# make soak       run the tests that take too long for daily use
# make lint       formatting, static checks, types, and the pipelines
# make pipelines  check workflows, container and citation
# make mutate     put small faults into the sources and count those that tests notice;
#                 MUTATE='cli --number 5 --seed 7' chooses area, number and seed
# make jax        install JAX, which `make docs` and the tests of exported models use
# make docs       build the documentation as a site in site/, strictly, notebooks executed
# make dist       build and check the wheel and the source archive in dist/
# make interop    install other FMI engines in .tools and compare them with ours
# make benchmark  speed and memory, recorded, not judged

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
override IGNORED += tests/benchmarks tests/interop
PROCESSES ?= $(shell nproc 2>/dev/null || echo 2)
SPREAD := -n $(PROCESSES) --dist loadfile --no-loadscope-reorder
# Of .ci/run: the name of the report that its summary reads, and the seconds that are left.
REPORT ?=
SECONDS_LEFT ?=
SPREAD += $(REPORT:%=--junitxml .ci/out/%.xml -o junit_family=xunit1)
SPREAD += $(SECONDS_LEFT:%=--session-timeout %)
KERNELS ?= Prescott Haswell
MARKS ?= not soak
C_FILES := $(wildcard hesr_model/equations/*.[ch] fmu_src/c/*.c fmu_src/c/*.h tests/fmu/*.c tests/fmu/*.h tests/fmu/one_file/*.c tests/fmu/one_file/m7/*.[ch] tests/cosim/properties/*.c tests/benchmarks/*.c)

# As many test processes as cores: more threads of linear algebra would wait for each other.
near test rest test-all contract hard kernels nightly-tests soak: export OMP_NUM_THREADS = 1

# Tests start many processes, which would compile all modules again without bytecode.
unexport PYTHONDONTWRITEBYTECODE

HARD := tests/fuzz tests/unit/test_cache.py tests/unit/test_files.py $(patsubst %,tests/cosim/test_%.py, \
  hard_to_break full_disks hostile_archives foreign_fmus workers replay cli_interrupts)

FITS := tests/numbers/test_numbers_of_laws.py tests/numbers/test_numbers_of_bodies.py $(patsubst %,tests/unit/test_%.py, \
  classic_laws dahl least_squares lugre_load networks parfam parfam_edges parfam_extended parfam_s \
  parfam_velocity per_log refinement ripple separable strain_wave stribeck)

.PHONY: run near test rest test-all gate contract hard hard-files kernels durations nightly \
  nightly-tests soak mutate messages lint format docs pipelines dist interop benchmark jax clean

run: $(VENV)/run
	$(BIN)/hesr run

near: $(VENV)/installed
	$(BIN)/python tests/near.py $(NEAR) -- $(SPREAD) $(FAIL_FAST)

test: $(VENV)/installed
	$(BIN)/pytest $(IGNORED:%=--ignore=%) $(SPREAD) -m "not ci and not soak"

rest: $(VENV)/installed
	$(BIN)/pytest $(IGNORED:%=--ignore=%) $(SPREAD) -m "ci and not soak"

test-all: $(VENV)/installed
	$(BIN)/pytest $(IGNORED:%=--ignore=%) $(SPREAD) -m "not soak"

gate: lint
	$(MAKE) test REPORT=test
	$(MAKE) rest REPORT=rest
	$(MAKE) kernels hard

contract: $(VENV)/installed
	$(BIN)/pytest tests/contract $(SPREAD) -m "$(MARKS)"

hard-files:  # for those who ignore them elsewhere
	@echo $(HARD)

hard: $(VENV)/installed
	(trap "" INT; exec $(BIN)/pytest $(HARD) $(SPREAD) -m "$(MARKS)") & wait $$!

kernels: $(VENV)/installed
	for kernel in $(KERNELS); do \
	  OPENBLAS_CORETYPE=$$kernel $(BIN)/pytest $(FITS) $(SPREAD) -m "not ci and not soak" || exit 1; \
	done

durations: $(VENV)/installed
	$(BIN)/python tests/cpu_time.py .ci/out/test.xml .ci/out/rest.xml \
	  $(wildcard .ci/out/nightly-*.xml)

messages: $(VENV)/installed
	$(BIN)/python tests/sentences.py >messages.txt

nightly: $(VENV)/installed
	$(BIN)/python .ci/nightly $(GROUPS)

nightly-tests: $(VENV)/installed
	$(BIN)/pytest $(IGNORED:%=--ignore=%) $(SPREAD) -m "not soak" --nightly $(GROUP) --timeout 3600 \
	  --junitxml .ci/out/nightly-$(GROUP).xml -o junit_family=xunit1

soak: $(VENV)/installed
	$(BIN)/pytest $(IGNORED:%=--ignore=%) -n 2 --dist worksteal -m soak --timeout 0

mutate: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --editable '.[mutation]'
	$(BIN)/python tests/mutation/run.py $(MUTATE)

lint: $(VENV)/installed pipelines
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/clang-format --dry-run -Werror $(C_FILES)

pipelines: $(VENV)/installed
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.dependabot .github/dependabot.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.github-issue-forms .github/ISSUE_TEMPLATE/[!c]*.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.github-issue-config .github/ISSUE_TEMPLATE/config.yml
	[ ! -x $(BIN)/hadolint ] || $(BIN)/hadolint Dockerfile
	$(BIN)/check-jsonschema --builtin-schema vendor.citation-file-format CITATION.cff
	$(BIN)/pre-commit validate-config

dist: $(VENV)/installed
	rm -rf dist
	$(BIN)/python -m build
	$(BIN)/twine check --strict dist/*

format: $(VENV)/installed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(C_FILES)

docs: jax
	$(BIN)/sphinx-build -q -W --keep-going -c docs/site . site
	$(BIN)/pytest tests/browser/test_docs_site.py tests/docs/test_tutorial.py --nightly site

interop: $(VENV)/installed
	.ci/interop .tools/interop
	$(BIN)/pytest tests/interop

benchmark: $(VENV)/installed
	$(BIN)/pytest tests/benchmarks --timeout 0 --benchmark-columns=min,median,max,rounds

jax: $(VENV)/installed  # of one notebook and exported models; no extra has it
	$(BIN)/python -m pip install --quiet 'jax>=0.4.30'

# What a run needs, by uv, which installs in seconds, or with the settings of pip.
$(VENV)/run: pyproject.toml
	$(PYTHON) -c "import sys; sys.exit('HESR needs Python 3.11 or newer.' if sys.version_info < (3, 11) else 0)"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip install --quiet --python $(BIN)/python --editable . \
	  || $(BIN)/python -m pip install --quiet --editable .
	touch $@

# What tests, lint and documentation need as well.
$(VENV)/installed: $(VENV)/run
	$(BIN)/uv pip install --quiet --python $(BIN)/python --editable '.[dev,docs]' \
	  || $(BIN)/python -m pip install --quiet --editable '.[dev,docs]'
	touch $@

clean:
	rm -rf .venv site jupyter_execute .mypy_cache .ruff_cache .pytest_cache .hypothesis .benchmarks
