# Many actuators, each with a log and a move of its own; only what changed is made again.
#
#     make -f workflow/day.mk -j8
#
# logs/NAME.csv          recorded while excitation.csv was played
# trajectories/NAME.csv  what each actuator is to do
# tracked/NAME.csv       recorded while drives/NAME.csv was played (appears after the second visit to the bench)
NAMES := $(basename $(notdir $(wildcard logs/*.csv)))
TRACKED := $(basename $(notdir $(wildcard tracked/*.csv)))

all: $(NAMES:%=drives/%.csv) $(TRACKED:%=reports/%.json)

.SECONDARY:        # keep the models
.DELETE_ON_ERROR:  # a report that missed its limit does not count as made

models/%.json: logs/%.csv
	@mkdir -p models
	dbo identify $< -o $@

drives/%.csv: models/%.json trajectories/%.csv
	@mkdir -p drives
	dbo compensate models/$*.json trajectories/$*.csv --on-limit error -o $@

reports/%.json: tracked/%.csv
	@mkdir -p reports
	dbo report $< --max-nrmse-percent 2 -o $@
