#!/bin/sh
# Try a step of a batch; where it fails, keep its error instead of ending the batch.
#
#     sh attempt.sh ERRORS NEEDED OUTPUT... -- COMMAND...
#
# ERRORS gets what the command said on standard error, and is empty where it went well. Where it failed, the OUTPUTs
# of an earlier run are removed, since they no longer belong to the log. Without NEEDED, what the step before makes,
# nothing is tried. The exit code is 0 but for a run that was interrupted.
set -u
errors=$1
needed=$2
shift 2

remove() {
    while [ "$1" != -- ]; do
        rm -f -- "$1"
        shift
    done
}
attempt() {
    while [ "$1" != -- ]; do shift; done
    shift
    "$@" 2> "$partial"
}

mkdir -p -- "${errors%/*}"
partial=$errors.$$.partial
trap 'rm -f -- "$partial"' EXIT
if [ -e "$needed" ]; then
    attempt "$@"
    code=$?
else
    echo "not tried without $needed" > "$partial"
    code=1
fi
if [ "$code" -ge 126 ]; then
    cat -- "$partial" >&2
    exit "$code"
fi
if [ "$code" -ne 0 ]; then
    remove "$@"
    if [ -e "$needed" ]; then cat -- "$partial" >&2; fi
    if [ ! -s "$partial" ]; then echo "exit code $code" > "$partial"; fi
else
    : > "$partial"
fi
mv -f -- "$partial" "$errors"
