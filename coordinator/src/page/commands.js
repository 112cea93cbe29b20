// Commands that repeat a job.

import { element } from "./words.js";

/** A word as a shell reads it. */
function quoted(text) {
  return /^[\w./:@%+=,-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;
}

/** A value as `--set` reads it. */
function setting(value) {
  return typeof value === "object" ? JSON.stringify(value) : String(value);
}

function settingsOf(job) {
  const { type, ...settings } = job.integrator ?? job.spec.integrator;
  const given = Object.entries(settings).filter(([, value]) => value !== null);
  return [`--integrator ${type}`, ...given.map(([name, value]) => `--set ${quoted(`${name}=${setting(value)}`)}`)];
}

function choices(job) {
  const { spec } = job;
  return [
    ...Object.entries(spec.defines ?? {}).map(([name, value]) => `-D ${quoted(`${name}=${value}`)}`),
    ...(spec.sensor ? [`--sensor ${quoted(spec.sensor)}`] : []),
    ...settingsOf(job),
    `--iterations ${spec.iterations}`,
    `--seed ${spec.seed ?? 0}`,
  ];
}

/** The commands with what each is for. */
export function commandsOf(job) {
  const farm = `--coordinator ${quoted(location.href.replace(/#.*/, "").replace(/\/$/, ""))}`;
  const scene = quoted(job.spec.main);
  return [
    ["Fetch the picture as it stands", `photonfarm fetch ${job.id} -o job-${job.id}.exr ${farm}`],
    ["Repeat the picture, bit for bit, from the scene's folder", `photonfarm render ${scene} --from job-${job.id}.exr -o again.exr`],
    ["The same on this farm, as a new job", `photonfarm resubmit ${job.id} ${farm}`],
    ["The same with every setting, to change some", `photonfarm submit ${scene} ${choices(job).join(" ")} ${farm}`],
  ];
}

export function commandsView() {
  const list = element("dl", { class: "commands" });
  const node = element("section", {}, element("h2", {}, "Commands that repeat it"), list);
  let shown = "";
  const update = (job) => {
    const commands = commandsOf(job);
    if (String(commands) === shown) return;
    shown = String(commands);
    list.replaceChildren(...commands.flatMap(([text, command]) => {
      const copy = element("button", { type: "button", "aria-label": `Copy: ${text}`, click: () => navigator.clipboard?.writeText(command) }, "Copy");
      copy.hidden = !navigator.clipboard;
      return [element("dt", {}, text), element("dd", {}, element("code", {}, command), copy)];
    }));
  };
  return { node, update };
}
