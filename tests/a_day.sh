#!/bin/sh
# A day with an installed dbo, in an empty folder: FOLDER is where the sample logs are.
set -eu
samples=$1
dbo --version
dbo excite --v-min 0 --v-max 100 --max-slew 2000 --sample-rate 5000 -o excitation.csv
dbo identify "$samples/identification.csv" -o model.json
dbo show model.json
dbo compensate model.json "$samples/trajectory.csv" --v-min 0 --v-max 100 --max-slew 2000 \
    --from 0 --approach auto --summary summary.json -o drive.csv
dbo check drive.csv --v-min 0 --v-max 100 --max-slew 2000 --from 0
dbo simulate model.json drive.csv -o predicted.csv
dbo report predicted.csv --trajectory drive.csv --max-nrmse-percent 1 -o report.html
dbo export model.json --sample-rate 10000 -o firmware
dbo waveform drive.csv --to npy -o drive.npy
test -s report.html && test -s drive.npy && test -s firmware/README.md
rm -rf excitation.csv model.json drive.csv predicted.csv report.html summary.json drive.npy firmware
