# Each target works on a machine that has Python 3.11 with venv, make, and the package index: the first one
# that needs it creates .venv and installs the versions pinned in constraints.txt.
PYTHON ?= python3
VENV := .venv
BENCH_VENV := .venv-bench
OUT := out
export PIP_CONSTRAINT := $(CURDIR)/constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# for `make results`: sequences with ground truth, and the models of OpenCV's tracker nano; neither is part of this
SEQUENCES ?= ../shared/sequences
NANO ?= ../shared/reference/nanotrack/nanotrack_backbone_sim.onnx ../shared/reference/nanotrack/nanotrack_head_sim.onnx
TRACKERS ?= mscf reference paper bacf bacf+al bacf+ahl csrt kcf mosse mil nano

.PHONY: help demo test lint bench results clean
help:
	@echo "make demo   fly the closed loop in the simulator; video, plots, verdict and a page in $(OUT)/demo/"
	@echo "make test   all tests"
	@echo "make lint   ruff, mypy, import-linter"
	@echo "make bench  milliseconds by stage, beside OpenCV's CSRT"
	@echo "make results  accuracy on SEQUENCES, by OPE, TRE and SRE; hours; goes on where it was interrupted"

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

results: $(BENCH_VENV)/installed
	for protocol in ope tre sre; do \
	  $(BENCH_VENV)/bin/mscf eval $(SEQUENCES) --tracker $(TRACKERS) --nano $(NANO) --protocol $$protocol --jobs 2 \
	    --out $(OUT)/results/$$protocol --resume || exit; \
	done

clean:
	rm -rf $(VENV) $(BENCH_VENV) $(OUT)

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install -q -e '.[dev]'
	@touch $@

$(BENCH_VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(BENCH_VENV)
	$(BENCH_VENV)/bin/pip install -q numpy opencv-contrib-python-headless threadpoolctl tqdm matplotlib
	$(BENCH_VENV)/bin/pip install -q --no-deps -e .
	@touch $@
