# make run        set everything up in .venv and do the main job
# make test       set everything up and run the tests
# make lint       formatting, static checks, types
# make interop    install other FMI engines in .tools and compare them with ours
# make benchmark  speed and memory, recorded, not judged

PYTHON ?= python3
BIN := .venv/bin
C_FILES := $(wildcard fmu_src/c/*.c fmu_src/c/*.h tests/fmu/*.c tests/fmu/*.h tests/cosim/properties/*.c)

.PHONY: run test lint format interop benchmark clean

run: .venv/installed
	$(BIN)/hesr run

test: .venv/installed
	$(BIN)/pytest -n 2 --dist loadfile --ignore=tests/benchmarks

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/clang-format --dry-run -Werror $(C_FILES)

format: .venv/installed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(C_FILES)

interop: .venv/installed
	.ci/interop .tools/interop
	$(BIN)/pytest tests/interop

benchmark: .venv/installed
	$(BIN)/pytest tests/benchmarks --benchmark-columns=min,median,max,rounds

.venv/installed: pyproject.toml
	$(PYTHON) -c "import sys; sys.exit('HESR needs Python 3.11 or newer.' if sys.version_info < (3, 11) else 0)"
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	touch $@

clean:
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .hypothesis .benchmarks
