// Elements, and numbers and times as text. Data goes in as text nodes, never through the HTML parser.

export const byId = (id) => document.getElementById(id);

/** An element: h('button', { id: 'go', onclick: go }, 'Go'). null and false leave an attribute out. */
export function h(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith('on')) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? '' : value);
  }
  element.append(...children);
  return element;
}

/** Sets a text only where it differs: screen readers repeat what is set again, and a selection would be lost. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export const symbols = { good: '✓', attention: '!', alarm: '✕' };

export function number(value, digits = null) {
  if (value === null || value === undefined) return '–';
  if (Array.isArray(value)) return value.map((each) => number(each, digits)).join(' ');
  if (typeof value !== 'number') return String(value);
  if (digits !== null) return value.toFixed(digits);
  return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(7)));
}

/** A UTC time (ISO text or ms) as ISO text with ms, as the server takes it. */
export const iso = (time) => new Date(time).toISOString();
export const clock = (time, decimals = 0) => iso(time).slice(11, decimals ? 20 + decimals : 19);
export const dateTime = (time, decimals = 0) => `${iso(time).slice(0, 10)} ${clock(time, decimals)}`;
/** The time of day, with the date where that is not the day of `reference`. */
export function since(time, reference) {
  return iso(time).slice(0, 10) === iso(reference).slice(0, 10) ? clock(time) : dateTime(time);
}

/** A sentence of the state; a null time is not known. */
export function sentence({ words, since: begun }, { view, now }) {
  return begun ? `${words}, since ${since(begun, view ?? now)} UTC` : words;
}

/** "18:04", "18:04:05", "2013-09-21 18:04" or full ISO, always UTC, as ms; NaN if it is no time. */
export function parseUtc(text, reference) {
  let full = text.trim().replace(/\s*(utc|z)$/i, '').replace(' ', 'T').replace(/^\d:/, '0$&');
  if (/^\d\d:/.test(full)) full = `${iso(reference).slice(0, 10)}T${full}`;
  return Date.parse(/T/.test(full) ? `${full}Z` : full);
}

export function duration(ms) {
  const seconds = Math.max(0, ms / 1000);
  const two = (value) => String(Math.floor(value)).padStart(2, '0');
  if (seconds < 60) return `${(Math.floor(seconds * 10) / 10).toFixed(1)} s`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min ${two(seconds % 60)} s`;
  if (seconds < 172800) return `${Math.floor(seconds / 3600)} h ${two((seconds / 60) % 60)} min`;
  return `${Math.floor(seconds / 86400)} d ${two((seconds / 3600) % 24)} h`;
}

/** Where a browser forbids storage, choices hold for this page only. */
function store(name) {
  return {
    get(key, otherwise) {
      try { return JSON.parse(window[name].getItem(`solaspect.${key}`)) ?? otherwise; } catch { return otherwise; }
    },
    set(key, value) {
      try { window[name].setItem(`solaspect.${key}`, JSON.stringify(value)); } catch { /* as said above */ }
    },
  };
}
/** Kept by this browser, for all its tabs. */
export const kept = store('localStorage');
/** Kept by this tab. */
export const tab = store('sessionStorage');
