# Each target works on a machine that has Python 3.11 with venv, make, and the package index: the first one
# that needs it creates .venv and installs the versions pinned in constraints.txt.
PYTHON ?= python3
VENV := .venv
BENCH_VENV := .venv-bench
OUT := out
export PIP_CONSTRAINT := $(CURDIR)/constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: help demo test lint bench clean
help:
	@echo "make demo   fly the closed loop in the simulator; video, plots, verdict and a page in $(OUT)/demo/"
	@echo "make test   all tests"
	@echo "make lint   ruff, mypy, import-linter"
	@echo "make bench  milliseconds by stage, beside OpenCV's CSRT"

demo: $(VENV)/installed
	$(VENV)/bin/mscf-companion sim --out $(OUT)/demo

test: $(VENV)/installed
	$(VENV)/bin/pytest -q -n 2

lint: $(VENV)/installed
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

# CSRT is in opencv-contrib-python-headless, which provides the same module cv2: an environment of its own
bench: $(BENCH_VENV)/installed
	$(BENCH_VENV)/bin/mscf bench

clean:
	rm -rf $(VENV) $(BENCH_VENV) $(OUT)

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install -q -e '.[dev]'
	@touch $@

$(BENCH_VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(BENCH_VENV)
	$(BENCH_VENV)/bin/pip install -q numpy opencv-contrib-python-headless threadpoolctl tqdm
	$(BENCH_VENV)/bin/pip install -q --no-deps -e .
	@touch $@
