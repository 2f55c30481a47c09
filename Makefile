# make demo      identify, compensate and report on the sample log; a page and a picture are left in demo/
# make test      ruff, mypy and pytest
# make package   a wheel and an archive in dist/, installed where nothing else is, and tried there
# make site      the pages of docs/ as a site, with the reference of the library, in site/
# make paper DATA=FOLDER      Section V of the publication from the authors' recordings, into paper/
# make evidence DATA=FOLDER   the error on recordings of others: the tables of docs/evidence.md, then benchmarks/rules.md
#                             (half an hour; RULES=none leaves the rules as they are, RULES=PRICE does one of them)
# make labs      the adapters in examples/ inside the programs of laboratories; downloads them
# make bench     the figures of speed, memory and exactness;  make attack  random drives and files
# make clean
#
# Needs python3 (3.11 or newer) and make; everything else is installed into .venv by the first call.
# Another interpreter: make PYTHON=python3.12 demo.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DBO := $(BIN)/dbo
BENCH := $(BIN)/python sample_data/virtual_actuator.py
KERNEL := $(wildcard dbo_cli/model/*.c dbo_cli/model/*.h)

.PHONY: help demo picture test package site paper evidence labs bench attack clean
.DELETE_ON_ERROR:

help:
	@sed -n 's/^# \{0,1\}//p' Makefile | sed -n '1,10p'

# --- the environment ---

$(VENV)/made:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "$(PYTHON) is missing or older than 3.11 (make PYTHON=python3.12 ... names another)"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { \
	  echo "$(PYTHON) cannot make a virtual environment (on Debian and Ubuntu: apt install python3-venv)"; exit 1; }
	@touch $@

$(VENV)/installed: $(VENV)/made pyproject.toml $(KERNEL)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
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
	@echo "demo/ holds the model, both drives, both measured logs, report.html and picture.png"

demo/model.json: $(LOG) | $(VENV)/installed
	@mkdir -p demo
	$(DBO) identify $(LOG) -o $@

demo/drive.csv: demo/model.json $(TRAJECTORY)
	$(DBO) compensate demo/model.json $(TRAJECTORY) --v-min 0 --v-max 100 --max-slew 2000 --from 0 --state empty --approach auto \
	  --summary demo/summary.json -o $@

demo/straight_line_drive.csv: $(LOG) $(TRAJECTORY) sample_data/straight_line.py | $(VENV)/installed
	@mkdir -p demo
	$(BIN)/python sample_data/straight_line.py $(LOG) $(TRAJECTORY) -o $@

demo/uncompensated.csv: demo/straight_line_drive.csv sample_data/virtual_actuator.py
	$(BENCH) demo/straight_line_drive.csv --seed 1 -o $@

demo/compensated.csv: demo/drive.csv sample_data/virtual_actuator.py
	$(BENCH) demo/drive.csv --seed 2 -o $@

demo/report.txt: demo/compensated.csv
	$(DBO) report demo/compensated.csv --expected demo/summary.json -o $@

demo/report.html: demo/uncompensated.csv demo/compensated.csv demo/report.txt
	$(DBO) report demo/uncompensated.csv demo/compensated.csv -o $@

# the picture at the top of README.md
picture: demo/picture.png
	cp demo/picture.png docs/demo.png

demo/picture.png: demo/uncompensated.csv demo/compensated.csv sample_data/draw_demo.py
	$(BIN)/python sample_data/draw_demo.py demo/uncompensated.csv demo/compensated.csv $@

# --- make test ---

test: $(VENV)/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check --quiet .
	$(BIN)/mypy
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -q -n auto --dist loadfile

# --- what is published ---

package: $(VENV)/made
	rm -rf dist build
	$(BIN)/python -m pip install --quiet --disable-pip-version-check build
	$(BIN)/python -m build --outdir dist . > dist.log || { cat dist.log; exit 1; }
	@rm dist.log
	$(PYTHON) -m venv --clear dist/venv
	dist/venv/bin/pip install --quiet --disable-pip-version-check dist/*.whl
	cd dist && PATH="$$PWD/venv/bin:$$PATH" sh ../tests/a_day.sh ../sample_data
	rm -rf dist/venv

site: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[site]"
	$(BIN)/python docs/make_reference.py
	$(BIN)/python -m mkdocs build --strict --quiet --site-dir site
	@echo "site/index.html"

# --- the rest ---

paper: $(VENV)/installed
	@test -n "$(DATA)" || { \
	  echo "make paper DATA=FOLDER: the authors' recordings (README.md says where they are public)"; exit 2; }
	$(BIN)/python benchmarks/paper.py "$(DATA)" paper

# one thread, as the program has: more fight for the cores
evidence bench: export OPENBLAS_NUM_THREADS := 1

evidence: $(VENV)/installed
	@test -n "$(DATA)" || { echo "make evidence DATA=FOLDER: a folder of recordings (docs/evidence.md)"; exit 2; }
	@mkdir -p evidence
	$(BIN)/python benchmarks/identification.py "$(DATA)" --save evidence/table.json
	$(BIN)/python benchmarks/linear_output_error.py "$(DATA)" evidence/linear.json
	$(BIN)/python docs/fill_evidence.py "$(DATA)" evidence/table.json evidence/linear.json
	$(BIN)/python benchmarks/rules.py "$(DATA)" evidence/table.json $(RULES)

labs: $(VENV)/installed-test
	examples/try_in_labs $(PYTHON)

bench: $(VENV)/installed-test
	for name in speed streams exactness; do $(BIN)/python benchmarks/$$name.py || exit 1; done

attack: $(VENV)/installed-test
	for name in attack_drives attack_live attack_files; do $(BIN)/python benchmarks/$$name.py || exit 1; done

clean:
	rm -rf demo paper evidence site dist build .labs *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
