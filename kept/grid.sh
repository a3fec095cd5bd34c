#!/bin/bash
# grid.sh [OPTIONS]: the placement grid from /root/base40, in /root/grid-out
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1 PYTHONPATH=/root/base40/src:/root/base40
cd /root/base40
echo ${PRIO:--10} > /proc/self/autogroup
exec /work/main/.venv/bin/python -m studies placement --scale thesis --out /root/grid-out "$@"
