// The page of a farm: which view is shown, signing in, and whether the farm is there.

import { ask, follow, Refused } from "./farm.js";
import { jobView } from "./job.js";
import { jobsView } from "./jobs.js";
import { element } from "./words.js";
import { workersView } from "./workers.js";

const place = document.getElementById("view");
const problem = document.getElementById("problem");
const connection = document.getElementById("connection");
const signOut = document.getElementById("sign-out");
let farm = null;
let view = null;

/** Shows what went wrong; an empty text takes it away. */
function tell(text) {
  problem.textContent = text;
  problem.hidden = !text;
}

function viewOf(hash) {
  const job = /^#\/jobs\/(\d+)$/.exec(hash);
  if (job) return jobView(farm, Number(job[1]), tell);
  return hash === "#/workers" ? workersView(farm, tell) : jobsView(farm, tell);
}

function show() {
  if (!farm) return;
  tell("");
  view?.stop?.();
  view = viewOf(location.hash);
  place.replaceChildren(view.node);
  view.update();
  document.title = `${view.title} - Photonfarm`;
  const workers = location.hash === "#/workers";
  document.querySelectorAll("nav a").forEach((link) => {
    if ((link.getAttribute("href") === "#/workers") === workers) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  });
}

function connected(is, forGood) {
  connection.textContent = is ? "live" : "the farm does not answer; trying again";
  connection.className = is ? "" : "lost";
  // A browser gives up where an answer is an error, as that of a proxy whose farm restarts, or of a token that ended.
  if (forGood) setTimeout(start, 2000);
}

function signIn(message) {
  connection.textContent = "not signed in";
  const token = element("input", { type: "password", autocomplete: "current-password", required: true, name: "token" });
  const form = element("form", {
    class: "sign-in",
    submit: async (event) => {
      event.preventDefault();
      try {
        await ask("POST", "session", {}, { authorization: `Bearer ${token.value.trim()}` });
        tell("");
        start();
      } catch (error) {
        tell(error.message);
      }
    },
  }, element("h1", {}, "Sign in"), element("p", {}, message), element("label", {}, "Token", token), element("button", {}, "Sign in"));
  place.replaceChildren(form);
  token.focus();
}

/** Connects with the farm, or asks who is there. */
async function start() {
  farm?.stop();
  farm = null;
  try {
    const session = await ask("GET", "session");
    signOut.hidden = !session.name;
    signOut.textContent = `Sign out ${session.name}`;
    farm = follow(() => view?.update(), connected);
    farm.role = session.role;
    show();
  } catch (error) {
    if (error instanceof Refused && [401, 403].includes(error.status)) signIn("This farm asks for a token. It is kept by your browser, where no page can read it.");
    else connected(false, true);
  }
}

signOut.addEventListener("click", async () => {
  await ask("DELETE", "session");
  signOut.hidden = true;
  start();
});
window.addEventListener("hashchange", () => {
  show();
  document.getElementById("main").focus({ preventScroll: true });
});
start();
