#!/bin/bash
# A campaign on an allocation of Slurm; docs/slurm.md explains. From the checkout, whose folder all nodes see:
#
#     sbatch docs/slurm.sh experiments/quickstart.py --results /shared/results
#
# With one GPU on each node, where runs learn in cohorts:
#
#     sbatch --nodes=1 --gpus-per-node=1 --mem=64G docs/slurm.sh experiments/quickstart.py \
#         --results /shared/results --device cuda
#
#SBATCH --job-name=tma-ray
#SBATCH --nodes=4
#SBATCH --ntasks-per-node=1
#SBATCH --cpus-per-task=16
#SBATCH --mem=32G
#SBATCH --time=24:00:00
#SBATCH --requeue
#SBATCH --no-kill
#SBATCH --signal=B:TERM@120
#SBATCH --open-mode=append
#SBATCH --output=tma-ray-%j.log
set -euo pipefail

venv="${TMA_RAY_VENV:-$PWD/.venv}"
export PATH="$venv/bin:$PATH"
command -v ray >/dev/null || {
    echo "no Ray in $venv: submit from the checkout, or name its virtual environment in TMA_RAY_VENV" >&2
    exit 2
}
export RAY_AUTH_MODE=token RAY_USAGE_STATS_ENABLED=0
# In the environment, which only its owner can read; a command line is everybody's.
RAY_AUTH_TOKEN=$(python -c 'import secrets; print(secrets.token_hex(32))')
export RAY_AUTH_TOKEN
ulimit -n "$(ulimit -Hn)"

# Of this job alone, also where several jobs share a node; below the ports that systems give away by themselves.
port=$((20000 + SLURM_JOB_ID % 6000 * 2))
place="${SLURM_TMPDIR:-/tmp}/ray-$SLURM_JOB_ID"
nodes=$(scontrol show hostnames "$SLURM_JOB_NODELIST")
head=${nodes%%$'\n'*}
address=$(getent ahostsv4 "$head" | awk 'NR == 1 { print $1 }')

# Each with its own --nodes and --ntasks: what a step is not given it inherits from the job.
step=(srun --overlap --ntasks-per-node=1 "--cpus-per-task=$SLURM_CPUS_PER_TASK")
each_node=(
    --block "--num-cpus=$SLURM_CPUS_PER_TASK" "--num-gpus=${SLURM_GPUS_ON_NODE:-0}"
    "--memory=$((${SLURM_MEM_PER_NODE:?give --mem} * 9 / 10 * 1024 * 1024))" --object-store-memory=200000000
    --min-worker-port=0 --max-worker-port=0 --dashboard-agent-listen-port=0
)

# Ray lets all users of a node write into its folder, which is therefore inside one of this user alone.
in_place='mkdir -pm 700 "$0" && [[ -O $0 && ! -L $0 ]] && chmod 700 "$0" && exec "$@"
    echo "$0 cannot be used: it belongs to another user" >&2; exit 1'

steps=()
again=no # whether a campaign that was stopped is queued again
leave() {
    trap - EXIT
    trap '' TERM INT
    kill -TERM "${steps[@]}" 2>/dev/null || true
    wait "${steps[@]}" 2>/dev/null || true
    "${step[@]}" "--nodes=$SLURM_JOB_NUM_NODES" "--ntasks=$SLURM_JOB_NUM_NODES" rm -rf "$place" || true
    # Where a partition has a grace time, a job that is preempted loses its steps, and this shell is told nothing.
    if [[ $(scontrol show job "$SLURM_JOB_ID") == *" PreemptTime=2"* && ! $1 =~ ^[02]$ ]]; then
        scontrol requeue "$SLURM_JOB_ID"
    elif [[ $again == yes && ! $1 =~ ^[012]$ ]]; then # not done, failed or refused, however it left
        scontrol requeue "$SLURM_JOB_ID"
    fi
    exit "$1"
}
trap 'leave $?' EXIT
trap 'again=yes; leave 130' TERM # the end of the time limit, or a job with precedence
trap 'leave 130' INT             # scancel --batch --signal=INT: for good
pause() { sleep "$1" & wait $!; } # which a signal ends

"${step[@]}" --nodes=1 --ntasks=1 --relative=0 bash -c "$in_place" "$place" \
    ray start --head "${each_node[@]}" \
    "--node-ip-address=$address" "--port=$port" "--ray-client-server-port=$((port + 1))" \
    --include-dashboard=false "--temp-dir=$place/ray" &
steps+=($!)
until (exec 3<>"/dev/tcp/$address/$port") 2>/dev/null; do
    kill -0 "${steps[0]}" || { echo "Ray did not start on $head" >&2; exit 1; }
    pause 1
done
if ((SLURM_JOB_NUM_NODES > 1)); then
    others=$((SLURM_JOB_NUM_NODES - 1))
    "${step[@]}" "--nodes=$others" "--ntasks=$others" --relative=1 bash -c "$in_place" "$place" \
        ray start "--address=$address:$port" "${each_node[@]}" &
    steps+=($!)
fi

# The cost that the campaign prints is that of the nodes that are there.
limit=$((SECONDS + 120))
until (($(ray status --address "$address:$port" 2>/dev/null | grep -c '^ *1 node_') == SLURM_JOB_NUM_NODES)); do
    ((SECONDS < limit)) || { echo "not all nodes have joined; starting without them" >&2; break; }
    pause 1
done

# A campaign that was killed holds its results root for 120 s.
((${SLURM_RESTART_COUNT:-0} == 0)) || pause 120

# In the background, so that this shell hears signals: the campaign then leaves with checkpoints.
python "$@" --yes --address "$address:$port" &
driver=$!
stop() {
    signalled=yes
    kill -TERM "$driver" 2>/dev/null || true
}
trap 'again=yes; stop' TERM
trap 'again=no; stop' INT
signalled=yes
while [[ $signalled == yes ]]; do # a signal ends the wait, not the driver
    signalled=no code=0
    wait "$driver" || code=$?
done
leave "$code"
