#!/bin/bash
# one38.sh SKILL TASK SEED [VARIANT] [METHOD]; first what /root/first lists, one training a line, once each
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
one() {
skill=$1 task=$2 seed=$3 variant=$4 method=$5
name=$skill-$task-$seed${variant:+-$variant}${method:+-$method}
base=/root/base38 runs=/root/base33-runs
[ $skill = close_fridge ] && base=/root/base39 runs=/root/base39-runs
mkdir -p $runs/done $runs/log; cd $base; export PYTHONPATH=$base/src
[ -e $runs/done/$name ] && return 0
mkdir $runs/lock-$name 2>/dev/null || return 0
echo -10 > /proc/self/autogroup
/root/base38/.venv/bin/perdure home train $skill --task $task ${variant:+--variant $variant} ${method:+--method $method} --seeds $seed --test-episodes 200 --cores 1 --out $runs >> $runs/log/$name 2>&1 && touch $runs/done/$name
rmdir $runs/lock-$name
}
while read -r line; do one $line < /dev/null; done < /root/first
one "$@"
