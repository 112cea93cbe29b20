// A job begins with files that are dropped onto the page, or chosen.

import { dropped, picked, readAll } from "./archive.js";
import { blake3 } from "./blake3.js";
import { checkView } from "./check.js";
import { acting, ask, Refused } from "./farm.js";
import { element } from "./words.js";

const SCENES = /\.(xml|pbrt|gltf|glb)$/i;
const INTEGRATORS = ["pppm", "pcf", "vcm", "bdpt", "path", "light", "surfaces", "sppm"];

/** Sends the files that the farm lacks, and returns the name of the bundle. */
async function send(files, told) {
  const manifest = {};
  const byHash = new Map();
  for (const [name, bytes] of files) {
    told(`reading ${name}`);
    const hash = await blake3(bytes);
    manifest[name] = { hash, bytes: bytes.length };
    byHash.set(hash, [name, bytes]);
  }
  const { bundle, missing } = await ask("POST", "bundles", { files: manifest });
  for (const [index, hash] of missing.entries()) {
    const [name, bytes] = byHash.get(hash);
    told(`sending ${name} (${index + 1} of ${missing.length})`);
    const answer = await fetch(`v1/blobs/${hash}`, { method: "PUT", body: bytes, headers: { "content-type": "application/octet-stream" } });
    if (!answer.ok) {
      const problem = await answer.json().catch(() => ({}));
      throw new Refused(answer.status, `${name}: ${problem.detail ?? answer.status}`);
    }
  }
  return bundle;
}

function nameOf(main, given) {
  const stem = main.replace(/.*\//, "").replace(SCENES, "");
  return (["scene", "main", "index"].includes(stem) && given ? given.replace(/\.(zip|tar|tar\.gz|tgz)$/i, "").replace(/\/.*/, "") : stem).slice(0, 100);
}

/** Sends files when it is first called, and again only where that failed; each caller is told how far it is. Returns the name of the bundle. */
function sendOnce(files) {
  let [sending, told] = [null, () => {}];
  return (tell) => {
    told = tell;
    sending ??= send(files, (text) => told(text)).catch((error) => {
      sending = null;
      throw error;
    });
    return sending;
  };
}

/** Values of a scene's parameters: pairs with spaces between them. */
function definesOf(text) {
  const pairs = text.split(/\s+/).filter(Boolean);
  const wrong = pairs.find((pair) => !/^[^=]+=/.test(pair));
  if (wrong) throw new Error(`${wrong} gives no parameter a value: write NAME=VALUE`);
  return Object.fromEntries(pairs.map((pair) => [pair.slice(0, pair.indexOf("=")), pair.slice(pair.indexOf("=") + 1)]));
}

/** The form that asks what is to be rendered. */
function form(act, close) {
  const option = (value) => element("option", { value }, value);
  const main = element("select", { name: "main", required: true });
  const name = element("input", { name: "name", maxlength: 100 });
  const integrator = element("select", { name: "integrator" }, INTEGRATORS.map(option));
  const iterations = element("input", { name: "iterations", type: "number", min: 1, step: 1, value: 64, required: true });
  const defines = element("input", { name: "defines", placeholder: "width=640 spp=16" });
  const told = element("p", { class: "quiet" });
  const start = element("button", { disabled: true, "aria-describedby": "check-said" }, "Render");
  const check = checkView((allowed) => (start.disabled = !allowed));
  // The name of the bundle, once the files are sent.
  let bundle = null;
  const asked = async (tell) => {
    const spec = { main: main.value, defines: definesOf(defines.value), integrator: { type: integrator.value } };
    return { ...spec, scene: await bundle(tell) };
  };
  const checkAgain = () => check.run(asked);
  const node = element("form", {
    hidden: true,
    submit: (event) => {
      event.preventDefault();
      act(async () => {
        start.disabled = true;
        try {
          const spec = await asked(() => {});
          const job = await ask("POST", "jobs", { ...spec, name: name.value, iterations: Number(iterations.value) });
          close();
          location.hash = `#/jobs/${job.id}`;
        } finally {
          start.disabled = false;
        }
      });
    },
  }, element("div", { class: "actions" }, element("label", {}, "Scene", main), element("label", {}, "Name", name), element("label", {}, "Integrator", integrator),
    element("label", {}, "Iterations", iterations), element("label", {}, "Parameters of the scene", defines)), told, check.node,
  element("div", { class: "actions" }, start, element("button", { type: "button", click: () => close() }, "Leave it")));
  [main, integrator, defines].forEach((field) => field.addEventListener("change", checkAgain));
  const show = (found, given) => {
    const scenes = [...found.keys()].filter((file) => SCENES.test(file)).sort((a, b) => a.split("/").length - b.split("/").length || a.length - b.length);
    if (scenes.length === 0) throw new Error("there is no scene among these files (.xml, .pbrt, .gltf, .glb)");
    main.replaceChildren(...scenes.map(option));
    name.value = nameOf(scenes[0], given);
    defines.value = "";
    told.textContent = `${found.size} ${found.size === 1 ? "file" : "files"}, ${[...found.values()].reduce((sum, bytes) => sum + bytes.length, 0).toLocaleString()} bytes.`;
    bundle = sendOnce(found);
    node.hidden = false;
    main.focus();
    checkAgain();
  };
  return { node, show, stop: check.stop };
}

export function dropView(tell) {
  const act = acting(tell);
  const inputs = [{ multiple: true }, { webkitdirectory: true }].map((more) =>
    element("input", { type: "file", hidden: true, ...more, change: (event) => take(picked(event.target)) }));
  const [choose, folder] = [["Choose files", inputs[0]], ["Choose a folder", inputs[1]]].map(([text, input]) => element("button", { type: "button", click: () => input.click() }, text));
  const hint = element("div", { class: "actions" }, element("p", {}, "Drop a scene here: a file, a folder, or an archive (zip, tar)."), choose, folder, inputs);
  const asked = form(act, () => {
    asked.stop();
    asked.node.hidden = true;
    hint.hidden = false;
    inputs.forEach((input) => (input.value = ""));
  });
  const node = element("section", { class: "drop", "aria-label": "New job" }, hint, asked.node);
  const take = (found) => act(async () => {
    const all = await found;
    asked.show(await readAll(all), all[0]?.[0]);
    hint.hidden = true;
  });
  const over = (event) => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault();
    node.classList.toggle("over", event.type === "dragover");
    if (event.type === "drop") take(dropped(event.dataTransfer));
  };
  ["dragover", "dragleave", "drop"].forEach((kind) => document.addEventListener(kind, over));
  const stop = () => {
    asked.stop();
    ["dragover", "dragleave", "drop"].forEach((kind) => document.removeEventListener(kind, over));
  };
  return { node, stop };
}
