// SPDX-License-Identifier: GPL-3.0-or-later
// A job type of Flamenco, Blender's farm manager: the light of many job folders, a share of them in each task.
// Put it into the Manager's folder "scripts"; btfsep is on the workers' PATH, or its path is the setting "btfsep".

const JOB_TYPE = {
    label: "BTFsep: light of many shots",
    settings: [
        { key: "jobs", type: "string", subtype: "dir_path", required: true,
          description: "The folder of the job folders, as the workers see it" },
        { key: "results", type: "string", subtype: "dir_path", required: true,
          description: "Gets a folder for each job, and batch.json and batch.csv" },
        { key: "tasks", type: "int32", default: 10, propargs: {min: 1, max: 100000},
          description: "Shares to cut the jobs into; some minutes of work in each are well" },
        { key: "preset", type: "string", default: "balanced", choices: ["draft", "balanced", "accurate", "paper"],
          description: "Speed against accuracy" },
        { key: "material", type: "string", default: "",
          description: "The material of all objects; empty: the job's, or recognised" },
        { key: "time_limit", type: "int32", default: 900, propargs: {min: 1},
          description: "Seconds for one shot" },
        { key: "lanes", type: "string", default: "auto", visible: "submission",
          description: "Shots at once on each worker" },
        { key: "btfsep", type: "string", default: "btfsep", visible: "web",
          description: "The program, or a variable of the Manager such as {btfsep}" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    const summary = task(settings, "summary", ["--join", settings.results, "--out", settings.results]);
    for (let share = 1; share <= settings.tasks; share++) {
        // a shot that fails is told by the summary: a task that failed would be tried again on every worker
        const args = [
            settings.jobs, "--out", settings.results, "--shard", `${share}/${settings.tasks}`, "--allow-failures",
            "--preset", settings.preset, "--lanes", settings.lanes, "--time-limit", `${settings.time_limit}`,
        ];
        if (settings.material) {
            args.push("--material", settings.material);
        }
        const estimate = task(settings, `estimate-${share}`, args);
        job.addTask(estimate);
        summary.addDependency(estimate);
    }
    job.addTask(summary);
}

function task(settings, name, args) {
    const made = author.Task(name, "misc");
    made.addCommand(author.Command("exec", { exe: settings.btfsep, args: ["batch", ...args] }));
    return made;
}
