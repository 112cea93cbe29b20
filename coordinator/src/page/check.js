// What a worker says of a scene, before a job is made of it.

import { ask, Refused } from "./farm.js";
import { element } from "./words.js";

// How long whoever wants to render is kept waiting for an answer, while no worker is at it [ms].
const PATIENCE = 6000;
// How often a check that the farm has forgotten is asked for again.
const ATTEMPTS = 3;

/** How many there are, and of which types. */
function byType(types) {
  const all = Object.entries(types);
  const total = all.reduce((sum, [, count]) => sum + count, 0);
  return all.length === 0 ? "none" : `${total} (${all.map(([name, count]) => `${name} ${count}`).join(", ")})`;
}

function factsOf(report) {
  const lamps = report.lamps.slice(0, 12).join(", ") + (report.lamps.length > 12 ? ` and ${report.lamps.length - 12} more` : "");
  const corner = (place) => `(${place.map((x) => Number(x.toPrecision(4))).join(", ")})`;
  return [
    ["Scene", `${report.scene}, ${report.format}`],
    ["Size", `${report.resolution.join(" × ")} pixels`],
    ["Shapes", `${byType(report.shapes)}; ${report.triangles.toLocaleString()} triangles, ${report.vertices.toLocaleString()} vertices`],
    ["Lights", byType(report.lights)],
    ["Lamps", lamps || "none"],
    ["Materials", byType(report.materials)],
    ["Textures", `${byType(report.textures)}; ${report.texels.toLocaleString()} texels`],
    ["Bounds", report.bounds ? report.bounds.map(corner).join(" to ") : ""],
  ].filter(([, value]) => value);
}

/** An error with the field that is to blame, where its text does not name it. */
function wordsOf(error) {
  return error.field && !error.message.includes(error.field) ? `${error.field}: ${error.message}` : error.message;
}

function listed(title, texts) {
  return texts.length === 0 ? [] : [element("h2", {}, title), element("ul", {}, texts.map((text) => element("li", {}, text)))];
}

function counted(count, what) {
  return `${count} ${count === 1 ? what : `${what}s`}`;
}

/**
 * Shows the answer to the latest question. `allow` is told whether a job may be made, at each change.
 * `run(question)` awaits what a question gives, such as the bundle once it is sent, and asks.
 */
export function checkView(allow) {
  const said = element("p", { id: "check-said", role: "status", "aria-live": "polite" });
  const details = element("div");
  const again = element("button", { type: "button", hidden: true, click: () => run(asked) }, "Check again");
  const node = element("section", { class: "check", "aria-label": "Check of the scene", hidden: true }, said, details, again);
  let round = 0;
  let asked = null;

  const say = (text, allowed, ...shown) => {
    if (said.textContent !== text) said.textContent = text;
    details.replaceChildren(...shown.flat());
    again.hidden = true;
    allow(allowed);
  };

  /** There is no answer, and nobody is asked any more. */
  const giveUp = (text, allowed) => {
    say(text, allowed);
    again.hidden = false;
  };

  const show = (status) => {
    const { report, failure } = status;
    if (report) {
      const warned = report.warnings.length === 0 ? "no warnings" : counted(report.warnings.length, "warning");
      const notes = report.notes.length === 0 ? [] : [element("details", {}, element("summary", {}, counted(report.notes.length, "note")), element("ul", {}, report.notes.map((note) => element("li", {}, note))))];
      say(`The scene can be rendered: ${warned}.`, true, listed("Warnings", report.warnings),
        element("dl", {}, factsOf(report).flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)])),
        element("details", {}, element("summary", {}, "Settings"), element("pre", { tabindex: 0, "aria-label": "Settings" }, JSON.stringify(report.integrator, null, 2))), notes);
    } else if (failure) {
      say(`The scene cannot be rendered: ${counted(failure.errors.length, "error")}. Mend it and drop it again, or change what is asked for.`, false,
        listed("Errors", failure.errors.map(wordsOf)), listed("Warnings", failure.warnings));
    } else {
      giveUp(`No worker could check the scene: ${status.reason}. You may render it all the same.`, true);
    }
  };

  /** Asks until there is an answer, or another question. */
  const follow = async (spec, isLatest) => {
    let idle = Date.now();
    let status = await ask("POST", "checks", spec);
    for (let lost = 0; isLatest(); ) {
      if (["done", "failed"].includes(status.state)) return show(status);
      if (status.state === "checking") {
        idle = Date.now();
        say("A worker looks at the scene.", false);
      } else {
        const free = Date.now() - idle > PATIENCE;
        say(free ? `Nobody has checked the scene yet (${status.waiting}). You may render it: a worker then tells what is wrong with it.` : `The scene waits for a worker (${status.waiting}).`, free);
      }
      try {
        status = await ask("GET", `checks/${status.id}?wait_ms=1000`);
      } catch (error) {
        if (!(error instanceof Refused && error.status === 404 && ++lost < ATTEMPTS)) throw error;
        status = await ask("POST", "checks", spec);
      }
    }
  };

  const run = async (question) => {
    const mine = ++round;
    const isLatest = () => mine === round;
    asked = question;
    node.hidden = false;
    say("The scene is made ready.", false);
    let spec = null;
    try {
      spec = await question((text) => isLatest() && say(text, false));
      if (isLatest()) await follow(spec, isLatest);
    } catch (error) {
      if (!isLatest()) return;
      // What the farm refuses of a check it refuses of a job as well. Where it is away or busy, that says nothing about the scene.
      const busy = !(error instanceof Refused) || [404, 429].includes(error.status) || error.status >= 500;
      if (spec && busy) giveUp(`The scene could not be checked: ${error.message}. You may render it all the same.`, true);
      else giveUp(error.message, false);
    }
  };
  const stop = () => {
    round += 1;
    node.hidden = true;
  };
  return { node, run, stop };
}
