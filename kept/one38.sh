#!/bin/bash
# one38.sh SKILL TASK SEED [VARIANT] [METHOD]
cd /root/base38; export PYTHONPATH=/root/base38/src OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
skill=$1 task=$2 seed=$3 variant=$4 method=$5
name=$skill-$task-$seed${variant:+-$variant}${method:+-$method}
[ -e /root/base33-runs/done/$name ] && exit 0
PY=/root/base38/.venv/bin/python
/root/base38/.venv/bin/perdure home train $skill --task $task ${variant:+--variant $variant} ${method:+--method $method} --seeds $seed --test-episodes 200 --cores 1 --out /root/base33-runs >> /root/base33-runs/log/$name 2>&1 && touch /root/base33-runs/done/$name
