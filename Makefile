# make demo    identify, compensate and report on the sample log; files and a picture are left in demo/
# make test    ruff, mypy and pytest
# make paper DATA=FOLDER   Section V of the publication from the authors' recordings, into paper/
# make compare DATA=FOLDER   the DBO beside its relatives on all recordings: the tables of docs/comparison.md
# make figures   every picture in docs/, the one in README.md, the man pages and docs/api.md
# make site   the pages of docs/ as a site, in site/;  make package  archives, built and tried, in archives/
# make fuzz    100,000 malformed inputs, 20,000 changed headers;  make clean
# make attack  killed runs, full disks, mutated models, random command lines, drives and live control (ATTACK=10: ten times as many)
# make mutants plants faults in the mathematics and says which no test finds (an hour on one core)
# make bench   the figures of speed, memory and exactness
#
# Needs python3 (3.11 or newer) and make; everything else is installed into .venv by the first call.
# Another interpreter: make PYTHON=python3.12 demo. On Windows see README.md.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DBO := $(BIN)/dbo
BENCH := $(BIN)/python sample_data/virtual_actuator.py
KERNEL := $(wildcard dbo_cli/hysteresis/*.c dbo_cli/hysteresis/*.h dbo_cli/interpolation/*.c dbo_cli/interpolation/*.h)

.PHONY: help demo picture figures test site package paper compare fuzz attack mutants bench clean
.DELETE_ON_ERROR:

help:
	@sed -n 's/^# \{0,1\}//p' Makefile | sed -n '1,13p'

# --- the environment ---

$(VENV)/made:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "$(PYTHON) is missing or older than 3.11 (make PYTHON=python3.12 ... names another)"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { \
	  echo "$(PYTHON) cannot make a virtual environment (on Debian and Ubuntu: apt install python3-venv)"; exit 1; }
	@touch $@

$(VENV)/installed: $(VENV)/made pyproject.toml $(KERNEL)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@mkdir -p $(VENV)/share/man/man1 && ln -sf $(CURDIR)/docs/man/*.1 $(VENV)/share/man/man1/  # no editable install does
	@touch $@

$(VENV)/installed-test: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[test]"
	@touch $@

# --- make demo: a log becomes a model, a trajectory becomes a drive, the bench is virtual ---

LOG := sample_data/identification.csv
TRAJECTORY := sample_data/trajectory.csv

demo: demo/report.html demo/picture.png
	@echo
	@cat demo/report.txt
	@echo
	@echo "demo/ holds the model, both drives, both measured logs, report.html, picture.png and more in figures/"

demo/model.json: $(LOG) | $(VENV)/installed
	@mkdir -p demo
	$(DBO) identify $(LOG) -o $@

demo/drive.csv: demo/model.json $(TRAJECTORY)
	$(DBO) compensate demo/model.json $(TRAJECTORY) -o $@

demo/straight_line_drive.csv: $(LOG) $(TRAJECTORY) sample_data/straight_line.py | $(VENV)/installed
	@mkdir -p demo
	$(BIN)/python sample_data/straight_line.py $(LOG) $(TRAJECTORY) -o $@

demo/uncompensated.csv: demo/straight_line_drive.csv sample_data/virtual_actuator.py
	$(BENCH) demo/straight_line_drive.csv --seed 1 -o $@

demo/compensated.csv: demo/drive.csv sample_data/virtual_actuator.py
	$(BENCH) demo/drive.csv --seed 2 -o $@

demo/report.txt: demo/uncompensated.csv demo/compensated.csv
	$(DBO) report demo/uncompensated.csv demo/compensated.csv -o $@

demo/report.html: demo/uncompensated.csv demo/compensated.csv demo/report.txt
	$(DBO) report demo/uncompensated.csv demo/compensated.csv --figures demo/figures -o $@

# the picture at the top of README.md
picture: demo/picture.png
	cp demo/picture.png docs/demo.png

demo/picture.png: demo/uncompensated.csv demo/compensated.csv sample_data/draw_demo.py
	$(BIN)/python sample_data/draw_demo.py demo/uncompensated.csv demo/compensated.csv $@

# --- make test ---

test: $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check --quiet .
	@echo "$(BIN)/mypy, beside $(BIN)/python -m pytest -q -n auto"
	@$(BIN)/mypy & types=$$!; $(BIN)/python -m pytest -q -n auto; suite=$$?; wait $$types && exit $$suite

# --- what is drawn and written from the program ---

figures: picture | $(VENV)/installed
	for name in make_figures make_dynamics_figures draw_imports make_man_pages make_api_page; do \
	  $(BIN)/python docs/$$name.py || exit 1; \
	done

# --- the pages of docs/ as a site: every link and anchor is checked, a broken one is an error ---

site: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[site]"
	$(BIN)/python -m mkdocs build --strict --quiet --site-dir site
	@echo "site/index.html"

# --- what is published: built, installed where nothing else is, and tried there ---

package:
	packaging/build_and_try $(PYTHON) archives

# --- the rest ---

paper: $(VENV)/installed
	@test -n "$(DATA)" || { \
	  echo "make paper DATA=FOLDER: the authors' recordings (README.md says where they are public)"; exit 2; }
	$(BIN)/python benchmarks/paper.py "$(DATA)" paper

compare: $(VENV)/installed
	@test -n "$(DATA)" || { \
	  echo "make compare DATA=FOLDER: the authors' recordings (README.md says where they are public)"; exit 2; }
	$(BIN)/python benchmarks/comparison.py "$(DATA)" --write

fuzz: $(VENV)/installed-test
	$(BIN)/python benchmarks/fuzz.py
	$(BIN)/python benchmarks/header_fuzz.py 20000

ATTACK ?= 1

attack: $(VENV)/installed-test
	$(BIN)/python benchmarks/attack/kills.py $$((200 * $(ATTACK)))
	$(BIN)/python benchmarks/attack/full_disk.py $$((200 * $(ATTACK)))
	$(BIN)/python benchmarks/attack/mutants.py $$((10000 * $(ATTACK)))
	$(BIN)/python benchmarks/attack/command_lines.py $$((10000 * $(ATTACK)))
	$(BIN)/python benchmarks/attack/drives.py $$((20000 * $(ATTACK)))
	$(BIN)/python benchmarks/attack/live.py $$((180 * $(ATTACK)))

mutants: $(VENV)/installed-test
	$(BIN)/python benchmarks/mutants.py

bench: $(VENV)/installed-test
	$(BIN)/python benchmarks/figures_page.py -o figures.md

clean:
	rm -rf demo paper site archives build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
