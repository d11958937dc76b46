#!/bin/bash
# user+sys CPU of bare fit
export HYSTFIT_DATA=/work/shared/data OPENBLAS_NUM_THREADS=1 PYTHONPATH=${TREE:-/work/wt/speed}
f=$1; shift
o=$(mktemp -d /tmp/sp/o.XXXX)
TIMEFORMAT="%U+%S user+sys, %R real"
cd $o
time timeout 300 /work/main/.venv/bin/python -m hystfit fit "$f" "$@" > $o/out.txt 2>&1
grep -E "status|model|left|cross" $o/out.txt | head -4
