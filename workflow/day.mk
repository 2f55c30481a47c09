# From a folder of logs to a model, a drive and a report for every actuator, and one table; only what changed is made
# again.
#
#     make -f workflow/day.mk -j8 LOGS=logs TRAJECTORY=trajectory.csv
#
# logs/NAME.csv is the identification log of the actuator NAME. results/ gets NAME.model.json, NAME.drive.csv with its
# summary NAME.drive.json, NAME.report.json (how well the model explains its log), errors/ and summary.csv.
# A log that is refused ends nothing: the others go on, the table has a line for every log, and then make fails,
# having named what failed. What failed is tried again next time.
#
# READ holds options of reading for all commands (READ="--skip-bad --time-unit ms"); IDENTIFY, COMPENSATE and REPORT
# hold further ones of one command. Names of logs may not hold blanks or any of : # $ % ; | * ? ' " \ ( ).

DBO ?= dbo
PYTHON ?= python3
LOGS ?= logs
OUT ?= results
TRAJECTORY ?= trajectory.csv
READ ?=
IDENTIFY ?=
COMPENSATE ?= --on-limit error
REPORT ?= --remove-offset

NAMES := $(patsubst $(LOGS)/%.csv,%,$(wildcard $(LOGS)/*.csv))
HERE := $(dir $(lastword $(MAKEFILE_LIST)))
ATTEMPT := sh $(HERE)attempt.sh
TABLE := $(PYTHON) $(HERE)table.py $(LOGS) $(OUT)
STEPS := model.json drive.csv report.json

.PHONY: all
.PRECIOUS: $(foreach step,$(STEPS),$(OUT)/errors/%.$(step))

ifeq ($(NAMES),)
$(error no logs: $(LOGS)/ holds no file NAME.csv (LOGS=FOLDER names another))
endif

# What a step makes, for make, is its file in errors/, which is empty where the step went well; one that is not, or
# whose result somebody deleted, is forgotten here, and so tried again.
FORGET := $(foreach name,$(NAMES),$(foreach step,$(STEPS),$(shell \
  test -e $(OUT)/$(name).$(step) || rm -f $(OUT)/errors/$(name).$(step))))

all: $(OUT)/summary.csv
	@$(TABLE) --judge

# The folder itself is newer where a log was added or taken away.
$(OUT)/summary.csv: $(LOGS) $(foreach step,$(STEPS),$(NAMES:%=$(OUT)/errors/%.$(step)))
	@$(TABLE)

$(OUT)/errors/%.model.json: $(LOGS)/%.csv
	@$(ATTEMPT) $@ $< $(OUT)/$*.model.json \
	  $(DBO) identify $< $(READ) $(IDENTIFY) --quiet -o $(OUT)/$*.model.json

$(OUT)/errors/%.drive.csv: $(OUT)/errors/%.model.json $(TRAJECTORY)
	@$(ATTEMPT) $@ $(OUT)/$*.model.json $(OUT)/$*.drive.csv \
	  $(DBO) compensate $(OUT)/$*.model.json $(TRAJECTORY) $(READ) $(COMPENSATE) --quiet \
	  --summary $(OUT)/$*.drive.json -o $(OUT)/$*.drive.csv

$(OUT)/errors/%.report.json: $(OUT)/errors/%.model.json
	@$(ATTEMPT) $@ $(OUT)/$*.model.json $(OUT)/$*.report.json \
	  $(DBO) report $(LOGS)/$*.csv --model $(OUT)/$*.model.json $(READ) $(REPORT) --quiet -o $(OUT)/$*.report.json
