#!/bin/sh
# Try a step of a batch; where it fails, keep its error instead of ending the batch.
#
#     sh attempt.sh ERRORS NEEDED OUTPUT COMMAND...
#
# ERRORS gets what the command said, and is empty where it went well. Without NEEDED, which the step before makes,
# nothing is tried. Where the step fails, the OUTPUT of an earlier run is removed: it no longer belongs to the log.
set -u
errors=$1
needed=$2
output=$3
shift 3
mkdir -p -- "${errors%/*}"
if [ ! -e "$needed" ]; then
    echo "not tried without $needed" > "$errors.partial"
    rm -f -- "$output"
elif "$@" 2> "$errors.partial"; then
    : > "$errors.partial"
else
    code=$?
    cat -- "$errors.partial" >&2
    if [ "$code" -ge 126 ]; then
        rm -f -- "$errors.partial"
        exit "$code" # interrupted, or there is no such program
    fi
    [ -s "$errors.partial" ] || echo "exit code $code" > "$errors.partial"
    rm -f -- "$output"
fi
mv -f -- "$errors.partial" "$errors"
