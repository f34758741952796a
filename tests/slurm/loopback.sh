#!/bin/sh
# A Slurm of one controller and two node daemons on this machine, in a scratch folder with its own keys and configuration.
#
#   loopback.sh start DIR [CPUS]   starts munged, slurmctld and two slurmd; returns when both nodes are idle
#   loopback.sh kill DIR NODE      kills the daemon of a node and what it runs, as a power cut would
#   loopback.sh stop DIR           ends all of it, by process id
#
# Programs find it by SLURM_CONF=DIR/slurm.conf. Needs root (slurmd starts jobs for others), slurm-wlm and munge.
set -eu
what=$1 dir=$2

# A free port, and the ones behind it, by the folder's name.
port() { echo $((20000 + $(echo "$dir" | cksum | cut -d' ' -f1) % 20000 + $1)); }

alive() { [ -s "$1" ] && kill -0 "$(cat "$1")" 2>/dev/null; }

end() { # a pid file: TERM, then KILL after two seconds
  alive "$1" || return 0
  pid=$(cat "$1")
  kill "$pid" 2>/dev/null || true
  tries=0
  while kill -0 "$pid" 2>/dev/null && [ $tries -lt 20 ]; do sleep 0.1; tries=$((tries + 1)); done
  kill -9 "$pid" 2>/dev/null || true
}

start() {
  cpus=${3:-2}
  mkdir -p "$dir/state" "$dir/node1" "$dir/node2" "$dir/log"
  host=$(hostname -s)
  dd if=/dev/urandom of="$dir/munge.key" bs=1024 count=1 2>/dev/null
  chmod 600 "$dir/munge.key"
  cat > "$dir/slurm.conf" <<EOF
ClusterName=loopback
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$(port 0)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$dir/munge.socket
CryptoType=crypto/munge
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
ReturnToService=2
SwitchType=switch/none
StateSaveLocation=$dir/state
SlurmctldPidFile=$dir/slurmctld.pid
SlurmdPidFile=$dir/%n.pid
SlurmdSpoolDir=$dir/%n
SlurmctldLogFile=$dir/log/slurmctld
SlurmdLogFile=$dir/log/%n
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerType=sched/backfill
SchedulerParameters=batch_sched_delay=0,sched_interval=2,bf_interval=2,sched_min_interval=100000,defer_batch
# A node that does not answer is down after so long; its jobs are taken up again elsewhere.
SlurmdTimeout=10
SlurmctldTimeout=10
InactiveLimit=0
KillWait=2
MinJobAge=300
MaxArraySize=1001
GresTypes=gpu
NodeName=node1 NodeHostname=$host NodeAddr=127.0.0.1 Port=$(port 1) CPUs=$cpus RealMemory=1000 State=UNKNOWN Gres=gpu:1
NodeName=node2 NodeHostname=$host NodeAddr=127.0.0.1 Port=$(port 2) CPUs=$cpus RealMemory=1000 State=UNKNOWN Gres=gpu:1
PartitionName=all Nodes=node1,node2 Default=YES MaxTime=INFINITE State=UP OverSubscribe=NO
EOF
  echo "NodeName=node[1-2] Name=gpu File=/dev/null" > "$dir/gres.conf"
  : > "$dir/cgroup.conf"
  munged --force --key-file="$dir/munge.key" --socket="$dir/munge.socket" --pid-file="$dir/munged.pid" \
    --log-file="$dir/log/munged" --seed-file="$dir/munge.seed" --num-threads=2
  export SLURM_CONF="$dir/slurm.conf"
  slurmctld -c -f "$SLURM_CONF"
  slurmd -N node1 -f "$SLURM_CONF"
  slurmd -N node2 -f "$SLURM_CONF"
  tries=0
  until [ "$(sinfo --noheader --Node --format=%t 2>/dev/null | grep -c '^idle$')" = 2 ]; do
    tries=$((tries + 1))
    if [ $tries -gt 100 ]; then
      sinfo --Node --long || true
      tail -n 20 "$dir"/log/* >&2
      "$0" stop "$dir"
      exit 1
    fi
    sleep 0.2
  done
}

case $what in
  start) start "$@" ;;
  kill)
    node=$3
    pid=$(cat "$dir/$node.pid")
    kill -9 "$pid"
    # What it runs: processes whose environment names the node, each after the step's own daemon, their parent.
    for entry in /proc/[0-9]*; do
      { environment=$(tr '\0' '\n' < "$entry/environ"); } 2> /dev/null || continue
      echo "$environment" | grep -qx "SLURMD_NODENAME=$node" || continue
      echo "$environment" | grep -qx "SLURM_CONF=$dir/slurm.conf" || continue
      parent=$(awk '/^PPid/ { print $2 }' "$entry/status" 2> /dev/null)
      if [ "$(cat "/proc/$parent/comm" 2> /dev/null)" = slurmstepd ]; then kill -9 "$parent" 2> /dev/null || true; fi
      kill -9 "${entry#/proc/}" 2> /dev/null || true
    done
    ;;
  stop)
    for daemon in slurmctld node1 node2 munged; do end "$dir/$daemon.pid"; done
    ;;
  *) echo "loopback.sh start|kill|stop DIR" >&2; exit 64 ;;
esac
