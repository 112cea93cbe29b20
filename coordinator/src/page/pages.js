// Jobs beyond the newest: they are fetched a page at a time, and those that do not match are not kept.

import { ask } from "./farm.js";

/** Jobs that are asked for at a time, as many as the farm gives. */
const PAGE = 100;
/** So many that match are enough for one look, */
const ENOUGH = 50;
/** and so many pages without them. */
const PATIENCE = 20;

function page(cursor) {
  return ask("GET", `jobs?limit=${PAGE}${cursor ? `&cursor=${encodeURIComponent(cursor)}` : ""}`);
}

/** Where the jobs after the newest ones begin; null where there are none. */
export async function afterTheNewest() {
  return (await page(null)).next ?? null;
}

/** Looks through the jobs from `cursor` on. `told` hears how many were looked at, and says whether to go on. */
export async function look(cursor, matches, told) {
  const jobs = [];
  let looked = 0;
  for (let pages = 0; cursor && pages < PATIENCE && jobs.length < ENOUGH; pages += 1) {
    const found = await page(cursor);
    looked += found.jobs.length;
    jobs.push(...found.jobs.filter(matches));
    cursor = found.next ?? null;
    if (!told(looked)) return null;
  }
  return { jobs, next: cursor, looked };
}
