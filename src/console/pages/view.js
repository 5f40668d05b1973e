// What this viewer shows: the flight, the time (live, paused or replayed), the line; and the stream of its events.
import { abandonDrawings, getJson, url } from './api.js';
import { iso, kept, tab } from './dom.js';

/** The answer of /api/flight. */
export const flight = {};
/** `at`: null for live, else a UTC; `playing`: whether time goes on from there, `speed` times as fast. */
export const choices = { at: null, playing: false, speed: 1, ...tab.get('time', {}), bits: kept.get('bits', null) };
/** On a thin line, pictures and plots are fetched only when asked for. */
export const thin = () => choices.bits !== null;
export const isLive = () => choices.at === null && flight.live;

const handlers = {};
/** Kinds: the server's events, and `view` (another view: drop everything), `flight`, `connection` (ms since lost, or null). */
export function on(kind, handler) { (handlers[kind] ??= []).push(handler); }
export function emit(kind, data) {
  for (const handler of handlers[kind] ?? []) {
    try { handler(data); } catch (error) { reportError(error); }
  }
}

// The server's clock and the time of the view, at the last `state`; between them this computer counts.
const last = { now: Date.now(), view: null, at: performance.now() };
const passed = () => performance.now() - last.at;
export const serverNow = () => last.now + passed();
/** A second at most is added: where no data come, the view does not move. */
export function viewNow() {
  const rate = choices.at === null ? Number(flight.live ?? false) : choices.playing * choices.speed;
  return (last.view ?? Date.parse(choices.at ?? flight.ends ?? iso(last.now))) + rate * Math.min(passed(), 1000);
}
/** How much faster than the clock the flight goes by. */
export const speed = () => (choices.playing ? choices.speed : 1);
/** Age in ms: on the ground's clock when live, on the flight's own otherwise. */
export function age({ time, arrived }) {
  return isLive() ? serverNow() - Date.parse(arrived) : viewNow() - Date.parse(time);
}
/** The time for questions to the server, null when live. */
export const at = () => (choices.at === null ? null : iso(viewNow()));

let presentOnly = false;
function keepTime() {
  if (!presentOnly) tab.set('time', { at: at(), playing: choices.playing, speed: choices.speed });
}

/** Shows another time, or at another speed, or over another line. */
export function select(change) {
  Object.assign(choices, { at: at() }, change);
  Object.assign(last, { view: choices.at && Date.parse(choices.at), at: performance.now() });
  kept.set('bits', choices.bits);
  keepTime();
  abandonDrawings();
  emit('view');
  begin();
}

const EVENTS = ['state', 'housekeeping', 'solution', 'propagated', 'picture', 'answer', 'training', 'left_out', 'end'];
const delays = (window.solaspectDelays = []);
let stream = null, opened = 0, heard = 0, lost = null, attempt = 0, leaving = false;

function take(kind, data) {
  if (kind === 'state') {
    Object.assign(last, { now: Date.parse(data.now), view: data.view && Date.parse(data.view), at: performance.now() });
    if (choices.playing) keepTime();
  }
  if (kind === 'end') select({ playing: false });
  emit(kind, data);
}

/** For measuring: ms from arrival on the ground to the drawn page. What had arrived before the stream opened does not count. */
function measure(arrived) {
  if (!(Date.parse(arrived) >= opened)) return;
  const drawn = () => {
    delays.push(Date.now() - Date.parse(arrived));
    if (delays.length > 2000) delays.shift();
  };
  if (document.hidden) setTimeout(drawn, 0);
  else requestAnimationFrame(drawn);
}

function connected(is) {
  if (is === (lost === null)) return;
  lost = is ? null : serverNow();
  emit('connection', lost);
}

/** The present values first, then the stream. A time that stands still needs no stream. */
async function begin() {
  const mine = ++attempt;
  stream?.close();
  const seen = new Set();
  if (choices.at === null || choices.playing) open(mine, seen);
  try {
    const now = await getJson(url('/api/now', { at: at() }));
    if (mine !== attempt) return;
    connected(true);
    for (const kind of ['state', 'housekeeping', 'solution', 'propagated']) {
      if (now[kind] && !seen.has(kind)) take(kind, now[kind]);
    }
    for (const picture of now.pictures) {
      if (!seen.has(`picture${picture.camera}`)) take('picture', picture);
    }
  } catch {
    if (mine === attempt) fail();
  }
}

function open(mine, seen) {
  stream = new EventSource(url('/api/live', { bits_per_s: choices.bits, at: at(), speed: choices.at && choices.speed }));
  [opened, heard] = [Date.now(), performance.now()];
  stream.onopen = () => { heard = performance.now(); };
  stream.onerror = () => { if (mine === attempt) fail(); };
  for (const kind of EVENTS) {
    stream.addEventListener(kind, (event) => {
      if (mine !== attempt) return;
      heard = performance.now();
      const data = JSON.parse(event.data);
      seen.add(kind + (data.camera ?? ''));
      connected(true);
      take(kind, data);
      measure(data.arrived);
    });
  }
}

// A browser keeps a page that was left, with its stream, and allows six connections in all.
window.addEventListener('pagehide', () => {
  attempt += 1;
  stream?.close();
  abandonDrawings();
});
window.addEventListener('pageshow', ({ persisted }) => { if (persisted) begin(); });

// A page that is being left loses its connection, too; that is no alarm. (A download is not the end of the page.)
window.addEventListener('beforeunload', () => {
  leaving = true;
  setTimeout(() => { leaving = false; }, 2000);
});

/** Tries again itself: the browser would begin a replay from its start, and gives up after an HTTP error. */
function fail() {
  const mine = ++attempt;
  stream?.close();
  if (!leaving) connected(false);
  setTimeout(async () => {
    if (mine !== attempt) return;
    const before = flight.version + flight.source;
    await learn().catch(() => {});
    if (before !== flight.version + flight.source) location.reload();
    else if (mine === attempt) begin();
  }, 2000);
}

/** Fetches /api/flight, at the start and after login or logout. */
export async function learn() {
  Object.assign(flight, await getJson('/api/flight'));
  emit('flight');
}

/** Begins. A page that must see the present (`present`) ignores a choice of time. */
export async function start(present = false) {
  presentOnly = present;
  if (present) Object.assign(choices, { at: null, playing: false });
  for (;;) {
    try { await learn(); break; } catch { connected(false); }
    await new Promise((again) => setTimeout(again, 2000));
  }
  if (flight.needs_login && !flight.logged_in) return;
  // A stream can be dead without an error; `state` comes each second, but shares a thin line with all else.
  setInterval(() => {
    if (stream?.readyState === EventSource.OPEN && performance.now() - heard > (thin() ? 30000 : 6000)) fail();
  }, 1000);
  begin();
}
