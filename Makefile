# Each target works on a machine that has Python 3.11 with venv, make, and the package index: the first one
# that needs it creates .venv and installs the versions pinned in constraints.txt.
PYTHON ?= python3
VENV := .venv
BENCH_VENV := .venv-bench
OUT := out
# what the packages are built of; after a change of it they are installed anew
BUILD := pyproject.toml setup.py constraints.txt $(wildcard mscf/kernels/src/*)
export PIP_CONSTRAINT := $(CURDIR)/constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# for `make results`: sequences with ground truth, the models of OpenCV's tracker nano, and the published colour names;
# none of them is part of this
SEQUENCES ?= ../shared/sequences
NANO ?= ../shared/reference/nanotrack/nanotrack_backbone_sim.onnx ../shared/reference/nanotrack/nanotrack_head_sim.onnx
COLOR_TABLE ?= ../shared/reference/color_names_reference.npz
TRACKERS ?= mscf reference paper bacf bacf+al bacf+ahl csrt kcf mosse mil nano
# preset mscf with one thing changed: what it adds to the published code taken away, then the paper's ideas as it means
# them: a label in closed form, threat by true sub-peaks, a pedestal of the stated size, none, a label that adapts at once
STUDY ?= sampling=pixels scale_interpolation=False color_weight=1 learning_rate=0.0158 hold_floor=0 \
  label_rule=joint,iterations=4 threat_rule=peaks pedestal_ratio=2.5,pedestal_min_cells=1,pedestal_centred=True \
  pedestal_height=0 label_penalty=0.27 train_interval=2
comma := ,

# the compiled core with AddressSanitizer and UndefinedBehaviorSanitizer, and the tests that run it
SANITIZED := $(OUT)/sanitized
SANITIZE := -fsanitize=address,undefined -fno-sanitize-recover=all
SANITIZED_TESTS := $(addprefix tests/mscf/,kernels features test_sampling.py test_spectrum.py test_filter.py test_scale.py \
  test_mutation.py test_confidence.py test_tracker.py)

.PHONY: help demo test lint sanitize bench results clean
help:
	@echo "make demo   fly the closed loop in the simulator; video, plots, verdict and a page in $(OUT)/demo/"
	@echo "make test   all tests"
	@echo "make lint   ruff, mypy, import-linter"
	@echo "make sanitize  the tests of the compiled core, with AddressSanitizer and UBSan"
	@echo "make bench  milliseconds by stage and kernels, beside OpenCV's CSRT"
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

sanitize: $(VENV)/installed
	rm -rf $(SANITIZED)
	CXXFLAGS="$(SANITIZE)" LDFLAGS="$(SANITIZE)" $(VENV)/bin/pip install -q --no-deps --target $(SANITIZED) .
	nm -D $(SANITIZED)/mscf/kernels/_native.abi3.so | grep -q __asan_init
	LD_PRELOAD="$$(gcc -print-file-name=libasan.so) $$(gcc -print-file-name=libubsan.so)" ASAN_OPTIONS=detect_leaks=0 \
	  $(VENV)/bin/pytest -q -o pythonpath="$(SANITIZED) tests" -k "not numpy" $(SANITIZED_TESTS)

# CSRT is in opencv-contrib-python-headless, which provides the same module cv2: an environment of its own
bench: $(BENCH_VENV)/installed
	$(BENCH_VENV)/bin/mscf bench

EVAL = $(BENCH_VENV)/bin/mscf eval $(SEQUENCES) --jobs 2 --resume
results: $(BENCH_VENV)/installed
	for protocol in ope tre sre; do \
	  $(EVAL) --tracker $(TRACKERS) --nano $(NANO) --protocol $$protocol --out $(OUT)/results/$$protocol || exit; \
	done
	$(EVAL) --tracker mscf $(addprefix mscf$(comma),$(STUDY)) --protocol tre --out $(OUT)/results/study
	$(EVAL) --tracker mscf reference --color-table $(COLOR_TABLE) --protocol tre --out $(OUT)/results/color_table

clean:
	rm -rf $(VENV) $(BENCH_VENV) $(OUT)

$(VENV)/installed: $(BUILD)
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install -q -e '.[dev]'
	@touch $@

$(BENCH_VENV)/installed: $(BUILD)
	$(PYTHON) -m venv $(BENCH_VENV)
	$(BENCH_VENV)/bin/pip install -q numpy opencv-contrib-python-headless threadpoolctl tqdm matplotlib
	$(BENCH_VENV)/bin/pip install -q --no-deps -e .
	@touch $@
