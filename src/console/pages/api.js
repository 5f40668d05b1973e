// Questions to the server. Every failure is an Error whose message is a sentence to be shown.
import { h, setText } from './dom.js';

export function url(path, parameters = {}) {
  const given = Object.entries(parameters).filter(([, value]) => value !== null && value !== undefined && value !== '');
  const query = new URLSearchParams(given).toString();
  return query ? `${path}?${query}` : path;
}

/** Ends the drawings that are under way: on a thin line they would hold up what is shown next. */
let drawings = new AbortController();
export function abandonDrawings() {
  drawings.abort();
  drawings = new AbortController();
}

async function ask(address, options) {
  let response;
  try { response = await fetch(address, options); } catch (error) {
    throw error.name === 'AbortError' ? error : new Error('no connection to the console');
  }
  if (response.ok) return response;
  const { error } = await response.json().catch(() => ({}));
  throw Object.assign(new Error(error ?? `the console answered ${response.status}`), { status: response.status });
}

export const getJson = async (address) => (await ask(address)).json();

export async function post(address, body = {}) {
  const response = await ask(address, {
    method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify(body),
  });
  return response.status === 204 ? null : response.json();
}

export async function getSvg(address) {
  const answer = await ask(address, { signal: drawings.signal });
  if (answer.status === 204) return '';
  const text = await answer.text();
  return document.importNode(new DOMParser().parseFromString(text, 'image/svg+xml').documentElement, true);
}

/** Puts a picture into `place` (an <img>) once it is decoded, so that the old one stays until then. */
export async function showPicture(place, address) {
  const image = h('img', { id: place.id, alt: place.alt });
  image.src = URL.createObjectURL(await (await ask(address, { signal: drawings.signal })).blob());
  await image.decode();
  URL.revokeObjectURL(place.src);
  place.src = image.src;
  place.hidden = false;
}

/** Runs `task`, and says beside it in words what failed; an empty text if nothing did, or it was abandoned. */
export async function reporting(place, task) {
  try {
    await task();
    setText(place, '');
  } catch (error) {
    setText(place, error.name === 'AbortError' ? '' : error.message);
  }
}

/** A function that asks for a run of `task`: one at a time, `gap` ms apart at least; requests meanwhile make one more run. */
export function paced(gap, task) {
  let begun = -Infinity, running = false, wanted = false, timer = null;
  async function run() {
    [timer, running, wanted, begun] = [null, true, false, performance.now()];
    try { await task(); } finally { running = false; }
    if (wanted) request();
  }
  function request() {
    wanted = true;
    if (!running) timer ??= setTimeout(run, Math.max(0, begun + gap - performance.now()));
  }
  return request;
}
