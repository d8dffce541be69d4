# make run    set everything up and open the studio; with no display, render the default avatar to out/default.png
# make test   set everything up, check the code, run every test
# make test-fast   the tests that need no window, no training and no copy of the packages: under three minutes on two cores
# make docs   the documentation's site, in out/site/; warnings are errors (--quiet would hide them from the count)
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
APT := libegl1 libgl1 libgl1-mesa-dri libglx-mesa0 libegl-mesa0 xvfb xauth
FAST := tests/test_facade.py tests/test_avatar.py tests/test_rooms.py tests/gl tests/ops tests/signals tests/templates  tests/fields \
  tests/volume tests/pointmap tests/shading
TOGETHER := -n 2 --dist loadfile --no-loadscope-reorder
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: setup system run check test test-fast docs gallery bench goldens clean

setup: $(VENV)/.ready system

system:
	@tools/system_packages.sh $(APT)

$(VENV)/.ready: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "Python 3.11 or newer is needed, this is " + sys.version' 
	@test -x $(BIN)/python || { echo "setup: making $(VENV)/"; $(PYTHON) -m venv $(VENV); } || \
	  { echo "setup: Debian keeps venv in a package of its own: apt-get install python3-venv"; rm -rf $(VENV); exit 1; }
	@echo "setup: installing into $(VENV)/; the first time some hundred MB are downloaded, which may take several minutes"
	@echo "setup: 1 of 2: torch, as in constraints.txt"
	@tools/pip_install.sh $(BIN)/python torch
	@echo "setup: 2 of 2: the packages of pyproject.toml, and this project"
	@tools/pip_install.sh $(BIN)/python --editable '.[dev,docs,video]'
	@touch $@
	@echo "setup: done"

run: setup
	@if [ -n "$$DISPLAY$$WAYLAND_DISPLAY" ]; then $(BIN)/avatarrex-studio; \
	else echo "run: no display; rendering the default avatar instead"; mkdir -p out; \
	  $(BIN)/avatarrex-studio render out/default.png --pose stand --expression smile --size 768 && \
	  echo "run: the default avatar is in out/default.png"; fi

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Two processes, a file of tests at a time, those with slow tests first (tests/conftest.py), so that both end together.
# One thread each: where two processes have two on two cores, threads of OpenMP spin for those that do not run, and tests take
# two to three times as much of the processor. Tests of threads set their number themselves.
# Windows have processes of their own, each with a display: Xlib ends one where the X server is lost (tests/app/conftest.py then
# names the test). They share nothing that is dear to make, so that whichever process is free takes the next.
test: export OMP_NUM_THREADS := 1
test: check
	$(BIN)/python -m pytest -q $(TOGETHER) -m "not window"
	$(BIN)/python -m pytest -q -n 2 --dist worksteal -m window tests/app

test-fast: setup
	$(BIN)/python -m pytest -q -m "not window and not slow" $(FAST)

docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

gallery: setup
	tools/gallery.sh $(BIN)/python

bench: setup
	$(BIN)/avatarrex-studio bench

goldens: setup
	$(BIN)/python -m pytest -q tests/goldens --regenerate-goldens

clean:
	rm -rf $(VENV) out build *.egg-info
