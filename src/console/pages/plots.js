// The page of plots: any fields over the same times, live or not. All that is chosen stands in the address.
import { getSvg, paced, reporting, url } from './api.js';
import { edges, savePng, saveSvg, watchPointer } from './chart.js';
import { byId, clock, dateTime, h, iso, kept, setText } from './dom.js';
import { begin } from './header.js';
import { at, choices, flight, isLive, on, thin, viewNow } from './view.js';

const RANGES = [[60, '1 min'], [600, '10 min'], [3600, '1 h'], [21600, '6 h'], [86400, '24 h'], [null, 'all']];
const FIRST = ['received.azimuth_deg', 'received.elevation_deg', 'solutions.offset_azimuth_deg', 'solutions.offset_elevation_deg'];

/** Either the last `range_s` seconds (null: all) up to the newest data, or `from` to `to` (ms). */
const chosen = { fields: [], range_s: 600, from: null, to: null };
const follows = () => chosen.from === null;

// ---- the address

function readHash() {
  const hash = new URLSearchParams(location.hash.slice(1) || kept.get('plot', ''));
  const [range, from, to] = [hash.get('range'), hash.get('from'), hash.get('to')];
  chosen.fields = (hash.get('fields') ?? '').split(',').filter(Boolean);
  chosen.range_s = range === 'all' ? null : Number(range) || 600;
  [chosen.from, chosen.to] = from && to ? [Date.parse(from), Date.parse(to)] : [null, null];
}

function writeHash() {
  const time = follows() ? `range=${chosen.range_s ?? 'all'}` : `from=${iso(chosen.from)}&to=${iso(chosen.to)}`;
  const hash = `fields=${chosen.fields.join(',')}&${time}`;
  kept.set('plot', hash);
  history.replaceState(null, '', `#${hash}`);
}

// ---- fields

function fieldRow({ field, name, unit, documentation }) {
  const box = h('input', { type: 'checkbox', value: field, checked: chosen.fields.includes(field), onchange: chooseField });
  return h('label', { 'data-search': `${field} ${unit} ${documentation}`.toLowerCase(), title: documentation },
    box, ` ${name} `, h('small', {}, unit ? `${unit} · ${documentation}` : documentation));
}

function buildFields() {
  if (byId('fields').firstChild) return;
  if (!chosen.fields.length) chosen.fields = FIRST.filter((name) => flight.fields.some(({ field }) => field === name)).slice(0, 2);
  for (const table of new Set(flight.fields.map((field) => field.table))) {
    const rows = flight.fields.filter((field) => field.table === table && field.number).map(fieldRow);
    byId('fields').append(h('fieldset', { 'data-table': table }, h('legend', {}, table), ...rows));
  }
  search();
}

function search() {
  const words = byId('search').value.toLowerCase().split(/\s+/);
  for (const set of byId('fields').children) {
    const rows = [...set.querySelectorAll('label')];
    for (const row of rows) row.hidden = !words.every((word) => row.dataset.search.includes(word));
    set.hidden = rows.every((row) => row.hidden);
  }
}

function chooseField({ target }) {
  chosen.fields = chosen.fields.filter((field) => field !== target.value);
  if (target.checked) chosen.fields.push(target.value);
  changed();
}

/** The chosen ones above the list, in the order of the panels; each is a button that takes it out. */
function showChosen() {
  byId('chosen').replaceChildren(...chosen.fields.map((field) =>
    h('button', { 'data-field': field, 'aria-label': `remove ${field}`, onclick: () => unchoose([field]) }, `${field} ✕`)));
}

function unchoose(fields) {
  chosen.fields = chosen.fields.filter((field) => !fields.includes(field));
  for (const box of byId('fields').querySelectorAll('input')) box.checked = chosen.fields.includes(box.value);
  changed();
}

// ---- range

/** The edges as the server takes them. An open end follows the newest data. */
function span() {
  if (!follows()) return { from: iso(chosen.from), to: iso(chosen.to) };
  return { from: chosen.range_s && iso(viewNow() - chosen.range_s * 1000), to: at() };
}

function fix(from, to) {
  Object.assign(chosen, { from, to });
  changed();
}

function follow(range_s) {
  Object.assign(chosen, { range_s, from: null, to: null });
  changed();
}

function pan(share) {
  const now = edges();
  if (now) fix(now.from + share * (now.to - now.from), now.to + share * (now.to - now.from));
}

/** About the middle; of a plot that follows, the newest end stays. */
function zoom(factor) {
  const now = edges();
  if (!now) return;
  const width = Math.max(1000, (now.to - now.from) * factor);
  if (follows()) follow(width / 1000);
  else fix((now.from + now.to - width) / 2, (now.from + now.to + width) / 2);
}

/** Follows the newest data with the width that is now shown. */
function live() {
  if (!follows()) follow((chosen.to - chosen.from) / 1000);
}

const KEYS = {
  ArrowLeft: () => pan(-0.25), ArrowRight: () => pan(0.25), '+': () => zoom(0.5), '=': () => zoom(0.5),
  '-': () => zoom(2), 0: () => follow(null), l: live, L: live,
};

// ---- the plot

let dragging = () => false;
/** At most 4 times a second, and never two at a time; the old plot stays until the new one is there. */
const fetchPlot = paced(250, () => reporting(byId('plot-error'), async () => {
  if (!chosen.fields.length) return byId('drawing').replaceChildren();
  const svg = await getSvg(url('/api/plot.svg', { fields: chosen.fields.join(','), ...span() }));
  if (dragging()) return;
  byId('drawing').replaceChildren(svg);
  showWindow();
}));

const fetchSpectrum = paced(1000, () => reporting(byId('spectrum-error'), async () => {
  if (byId('spectrum-show').ariaPressed !== 'true') return byId('spectrum').replaceChildren();
  byId('spectrum').replaceChildren(await getSvg(url('/api/spectrum.svg', span())));
}));

function showWindow() {
  const now = edges();
  const kind = !follows() ? 'fixed' : isLive() ? 'live' : 'up to the time of the view';
  setText(byId('span'), now ? `${dateTime(now.from)} to ${dateTime(now.to)} UTC · ${kind}` : '');
  for (const link of byId('save-csv').children) link.href = url('/api/table.csv', { fields: link.dataset.fields, ...span() });
}

function changed() {
  writeHash();
  showChosen();
  const tables = new Map();
  for (const field of chosen.fields) {
    const table = field.split('.')[0];
    tables.set(table, [...(tables.get(table) ?? []), field]);
  }
  byId('save-csv').replaceChildren(...[...tables].map(([table, fields]) =>
    h('a', { 'data-fields': fields.join(','), download: `${table}.csv` }, `CSV of ${table}`)));
  for (const button of byId('ranges').children) {
    button.ariaPressed = String(follows() && String(chosen.range_s) === button.dataset.range);
  }
  byId('follow').ariaPressed = String(follows());
  showWindow();
  fetchPlot();
  fetchSpectrum();
}

function take() {
  if (follows() && !thin() && !dragging()) fetchPlot();
}

function again() {
  byId('fetch').hidden = !thin();
  if (chosen.fields.length) changed();
}

byId('ranges').append(...RANGES.map(([range, name]) =>
  h('button', { 'data-range': String(range), onclick: () => follow(range) }, name)));
const BUTTONS = {
  earlier: () => pan(-0.25), later: () => pan(0.25), closer: () => zoom(0.5), wider: () => zoom(2), follow: live, fetch: fetchPlot,
};
for (const [id, act] of Object.entries(BUTTONS)) byId(id).addEventListener('click', act);
byId('none').addEventListener('click', () => unchoose(chosen.fields));
byId('search').addEventListener('input', search);
byId('plot').addEventListener('keydown', (event) => {
  const act = !event.ctrlKey && !event.metaKey && !event.altKey && KEYS[event.key];
  if (!act) return;
  event.preventDefault();
  act();
});
byId('spectrum-show').addEventListener('click', ({ target }) => {
  target.ariaPressed = String(target.ariaPressed !== 'true');
  fetchSpectrum();
});
const name = () => `solaspect ${iso(edges()?.from ?? 0).slice(0, 19).replaceAll(':', '')}`;
byId('save-svg').addEventListener('click', () => saveSvg(byId('drawing').firstElementChild, name()));
byId('save-png').addEventListener('click', () => reporting(byId('plot-error'), () => savePng(byId('drawing').firstElementChild, name())));
dragging = watchPointer(fix, (time) => setText(byId('pointer'), time === null ? '' : `· pointer ${clock(time, 1)}`));
window.addEventListener('hashchange', () => location.reload());
readHash();
on('flight', buildFields);
on('view', again);
on('solution', take);
on('housekeeping', take);
begin().then(again);
