# `make demo` and `make test` set up everything by themselves; Python 3.11+ with pip is enough.
PYTHON ?= python3
VENV ?= .venv
EDITABLE ?= -e
PYTEST_ARGS ?= -n 2 --dist loadgroup
BIN := $(VENV)/bin

.PHONY: demo test clean

demo: $(VENV)/.installed
	$(BIN)/dmptm diagnose "$$($(BIN)/python -m dmptm_ctrl.data demo_rig)" --out demo-report
	@echo "Open demo-report/report.html"

test: $(VENV)/.installed-test
	$(BIN)/python -m pytest $(PYTEST_ARGS)

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
