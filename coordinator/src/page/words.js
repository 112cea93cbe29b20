// Elements, and figures in words.

/** An element with attributes (functions become listeners) and children. */
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") made.addEventListener(name, value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value != null) made.setAttribute(name, value);
  }
  made.append(...children.flat().filter((child) => child != null && child !== false));
  return made;
}

/** A shape of an SVG with attributes and children. */
export function shape(tag, attributes = {}, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

/** A share in percent, with as many digits as it is worth. */
export function percent(share) {
  return `${Number((100 * share).toPrecision(share < 1 ? 2 : 3))} %`;
}

/** Bytes, such as 3.2 GB. */
export function size(bytes) {
  for (const [unit, length] of [["TB", 1e12], ["GB", 1e9], ["MB", 1e6]]) {
    if (bytes >= length) return `${(bytes / length).toPrecision(3)} ${unit}`;
  }
  return `${Math.round(bytes / 1e3)} kB`;
}

/** A span of time, such as 3 h. */
export function span(seconds) {
  for (const [unit, length] of [["d", 86400], ["h", 3600], ["min", 60]]) {
    if (seconds >= length) return `${Math.round(seconds / length)} ${unit}`;
  }
  return `${Math.max(0, Math.round(seconds))} s`;
}

export function since(time) {
  return span((Date.now() - Date.parse(time)) / 1000);
}

export function nameOf(job) {
  return job.spec.name || job.spec.main;
}

export function ended(job) {
  return ["done", "failed", "cancelled"].includes(job.state);
}

export function stateOf(job) {
  return job.spec.schedule?.paused && !ended(job) ? "paused" : job.state;
}

/** Iterations, and the time that is left at the present pace. */
export function progressOf(job) {
  const all = job.spec.iterations;
  const done = `${job.iterations_done} of ${all} iterations`;
  const pace = job.iterations_per_second;
  if (job.state !== "running" || !pace) return done;
  return `${done}, about ${span((all - job.iterations_rendered) / pace)} left`;
}

/** An amount of memory [MiB]; nothing where it is not known. */
export function memory(mebibytes) {
  if (mebibytes == null) return "";
  return mebibytes >= 10240 ? `${(mebibytes / 1024).toFixed(1)} GiB` : `${mebibytes} MiB`;
}

/** Why a job ended as it did, or nobody is at work on it. */
export function reasonOf(job) {
  if (job.failure) return job.failure;
  if (job.stop) return `stopped by its ${job.stop.reason === "noise" ? "noise target" : "deadline"}, of ${job.stop.asked}`;
  return job.waiting && !job.spec.schedule?.paused ? `waits: ${job.waiting}` : "";
}
