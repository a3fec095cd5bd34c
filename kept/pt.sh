#!/bin/bash
# pt.sh ARGS: tests with trainings stopped
pkill -STOP -f "studies placement|serve\(\)"
cd ${T:-/work/main}; echo -9 > /proc/self/autogroup
env -u PYTHONPATH OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 timeout 580 .venv/bin/python -m pytest -n2 --dist loadfile -m "not verify" "$@" 2>&1 | tail -40
pkill -CONT -f "studies placement|serve\(\)"
