#!/bin/sh
# running, success or failed of a Slurm job, by its controller. It forgets a job some minutes after its end
# (MinJobAge, 300 s by default): what it does not know any more has ended, and the files say how.
# An array or heterogeneous job is not sent by Snakemake, so that one state is all there is.
state=$(scontrol --oneliner show job "$1" 2>/dev/null | sed -n 's/.* JobState=\([A-Z_]*\).*/\1/p')
case $state in
  COMPLETED | "") echo success ;;
  BOOT_FAIL | CANCELLED | DEADLINE | FAILED | NODE_FAIL | OUT_OF_MEMORY | PREEMPTED | TIMEOUT) echo failed ;;
  *) echo running ;;
esac
