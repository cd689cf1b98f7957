#!/bin/sh
# The stages of 'make quickstart' after the installation: compile, train, report; then where the time went.
# Usage: sh experiments/quickstart.sh BIN RESULTS [SECONDS_OF_THE_INSTALLATION]
set -eu
bin=$1 results=$2 installation=${3:-0}

duration() { printf '%d min %02d s' "$(($1 / 60))" "$(($1 % 60))"; }

began=$(date +%s)
echo "[1/3] Compiling the physics: about half a minute, once per machine"
"$bin/python" experiments/quickstart.py --dry-run >/dev/null
compiled=$(date +%s)
echo "[2/3] Training these runs, one per core at a time: about 5 minutes on 2 cores; Ctrl-C stops, the same command resumes"
"$bin/python" experiments/quickstart.py --results "$results"
trained=$(date +%s)
echo "[3/3] Writing the report: a few seconds"
"$bin/tma-ray" report "$results"
reported=$(date +%s)

echo
echo "Where the time went:"
echo "  installation (once)  $(duration "$installation")"
echo "  compilation (once)   $(duration $((compiled - began)))"
echo "  training             $(duration $((trained - compiled)))"
echo "  report               $(duration $((reported - trained)))"
echo "Next: open $results/report/index.html in a browser, then type"
echo "  source $bin/activate && tma-ray ranking $results"
