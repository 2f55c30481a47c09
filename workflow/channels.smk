# From one log of many channels to a model and a drive of each, by Snakemake: on a cluster, some channels a job.
#
#     snakemake -s workflow/channels.smk --profile workflow/slurm --config log=log.h5 channels=128 trajectory=frames.h5
#
# Made are results/models/47.json and results/drives/47.csv of each channel: dbo takes 'results/models/{channel}.json'
# as a set. On one machine dbo does the same in two commands (-j 2 -o 'results/models/{channel}.json'), and sooner: the
# log is opened once. Settings, all optional, may also stand in a file given by --configfile: dbo, log, channels (a
# number, or names), part (channels a job), voltage, displacement, trajectory, desired, results, identify, compensate;
# {} stands for the channel.

DBO = config.get("dbo", "dbo")
OUT = config.get("results", "results")
COLUMNS = {
    role: str(config.get(role, default)).partition("{}")[::2]
    for role, default in (("voltage", "voltage_{}"), ("displacement", "displacement_{}"), ("desired", "desired_{}"))
}
given = config.get("channels", 1)
CHANNELS = [str(k) for k in range(1, given + 1)] if isinstance(given, int) else [str(one) for one in given]
SIZE = int(config.get("part", 16))
PARTS = [CHANNELS[k : k + SIZE] for k in range(0, len(CHANNELS), SIZE)]

localrules: all

rule all:
    input: [f"{OUT}/parts/{number}" for number in range(len(PARTS))]

rule part:
    input: log=config.get("log", "log.h5"), moves=config.get("trajectory", "frames.h5")
    output: touch(f"{OUT}/parts/{{number}}")
    params:
        channels=lambda part: PARTS[int(part.number)],
        voltage=COLUMNS["voltage"],
        displacement=COLUMNS["displacement"],
        desired=COLUMNS["desired"],
        identify=config.get("identify", ""),
        compensate=config.get("compensate", "--on-limit error"),
        out=OUT,
    shell:
        """
        mkdir -p {params.out:q}/models {params.out:q}/drives
        for channel in {params.channels:q}; do
          {DBO} identify {input.log:q} --voltage {params.voltage[0]:q}"$channel"{params.voltage[1]:q} \
            --displacement {params.displacement[0]:q}"$channel"{params.displacement[1]:q} {params.identify} --quiet \
            -o {params.out:q}/models/"$channel".json
          {DBO} compensate {params.out:q}/models/"$channel".json {input.moves:q} \
            --displacement {params.desired[0]:q}"$channel"{params.desired[1]:q} {params.compensate} --quiet \
            -o {params.out:q}/drives/"$channel".csv
        done
        """
