# `make demo` and `make test` set up everything by themselves; Python 3.11+ with pip is enough.
PYTHON ?= python3
VENV ?= .venv
EDITABLE ?= -e
PYTEST_ARGS ?= -n 2 --dist loadgroup
BIN := $(VENV)/bin

# Selection of effects, and runs through impacts: what a last bit could decide.
SENSITIVE := $(addprefix tests/,diagnosis/test_select.py diagnosis/test_dual_evidence.py \
	recovery/test_impact_chatter.py effects/test_backlash.py agreement/test_stick_slip.py \
	identify/test_gap_search.py)
# As a processor computes that has no fused and no wide instructions.
OLDER := NUMBA_CPU_NAME=generic OPENBLAS_CORETYPE=Nehalem

.PHONY: demo test test-long test-older clean

demo: $(VENV)/.installed
	$(BIN)/dmptm diagnose "$$($(BIN)/python -m dmptm_ctrl.data demo_rig)" --out demo-report
	@echo "Open demo-report/report.html"

test: $(VENV)/.installed-test
	$(BIN)/python -m pytest $(PYTEST_ARGS)

# Notebooks, the paper's figures, long logs: what need not run each time.
test-long: $(VENV)/.installed-test
	$(BIN)/python -m pytest $(PYTEST_ARGS) -m long

test-older: $(VENV)/.installed-test
	$(OLDER) NUMBA_CACHE_DIR=$(abspath $(VENV)/numba-older) $(BIN)/python -m pytest $(PYTEST_ARGS) $(SENSITIVE)

$(VENV)/.made:
	$(PYTHON) -m venv $(VENV) || $(PYTHON) -m virtualenv $(VENV)
	touch $@

$(VENV)/.installed: $(VENV)/.made pyproject.toml
	$(BIN)/python -m pip install --quiet $(EDITABLE) .
	touch $@

$(VENV)/.installed-test: $(VENV)/.made pyproject.toml
	$(BIN)/python -m pip install --quiet $(EDITABLE) '.[test]'
	touch $@ $(VENV)/.installed

clean:
	rm -rf $(VENV) demo-report
