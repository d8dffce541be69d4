# make run    set everything up and open the studio; with no display, render the default avatar to out/default.png
# make test   set everything up, check the code, run every test
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
APT := libegl1 libgl1 libgl1-mesa-dri libglx-mesa0 libegl-mesa0 xvfb xauth
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: setup run test check bench goldens clean

setup: $(VENV)/.ready system

system:
	@tools/system_packages.sh $(APT)

$(VENV)/.ready: pyproject.toml
	@$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "Python 3.11 or newer is needed, this is " + sys.version' 
	@test -x $(BIN)/python || { echo "setup: making $(VENV)/"; $(PYTHON) -m venv $(VENV); } || \
	  { echo "setup: Debian keeps venv in a package of its own: apt-get install python3-venv"; rm -rf $(VENV); exit 1; }
	@echo "setup: installing torch 2.13.0 and the packages of pyproject.toml into $(VENV)/ (some hundred MB the first time)"
	@$(BIN)/python -m pip install --quiet torch==2.13.0
	@$(BIN)/python -m pip install --quiet --editable '.[dev,video]'
	@touch $@

run: setup
	@if [ -n "$$DISPLAY$$WAYLAND_DISPLAY" ]; then $(BIN)/avatarrex-studio; \
	else echo "run: no display; rendering the default avatar instead"; mkdir -p out; \
	  $(BIN)/avatarrex-studio render out/default.png --pose stand --expression smile --size 768 && \
	  echo "run: the default avatar is in out/default.png"; fi

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Windows have a process of their own: Xlib ends it where the X server is lost (tests/app/conftest.py then names the test).
test: check
	$(BIN)/python -m pytest -q -m "not window"
	$(BIN)/python -m pytest -q -m window tests/app/test_window.py tests/app/test_runs_window.py

bench: setup
	$(BIN)/avatarrex-studio bench

goldens: setup
	$(BIN)/python -m pytest -q tests/goldens --regenerate-goldens

clean:
	rm -rf $(VENV) out build *.egg-info
