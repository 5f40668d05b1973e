// The page of the present: offsets, ages, pictures, the Sun on the plate, housekeeping.
import { getSvg, paced, showPicture, reporting, url } from './api.js';
import { byId, clock, dateTime, duration, h, kept, number, sentence, setText, symbols } from './dom.js';
import { begin } from './header.js';
import { watchTraining } from './training.js';
import { age, at, flight, on, speed, thin } from './view.js';

/** What has an age, and beyond how many seconds it is old. Pictures come only when a frame is sent. */
const OLD_S = { packet: 5, solution: 5, housekeeping: 5, picture: 600 };
/** What is counted on the line. */
const LINE = ['packets', 'missing', 'rejected', 'doubled', 'late', 'doubtful', 'bits_per_s'];
/** Of the agreement of cameras and gyros: none, within, beyond, contradicted. */
const SEVERITIES = ['good', 'good', 'attention', 'alarm'];
/** The newest of each kind. */
const newest = {};

/** A packet of any kind is the newest of all. In a fast replay, gaps are longer on the flight's clock. */
function showAges() {
  for (const [kind, limit] of Object.entries(OLD_S)) {
    const place = byId(`age-${kind}`);
    const events = kind === 'packet' ? Object.values(newest) : newest[kind] ? [newest[kind]] : [];
    const ms = Math.min(...events.map(age));
    const old = events.length > 0 && ms > limit * 1000 * speed();
    setText(place, events.length ? `${old ? '! old: ' : ''}${duration(ms)}` : 'none yet');
    place.dataset.old = old;
  }
}

/** A table's row with one cell for each of `ids`. */
function row(name, ids) {
  return h('tr', {}, h('th', { scope: 'row' }, name), ...ids.map((id) => h('td', { id }, id ? '–' : '')));
}

function showSentences(state) {
  const items = state.sentences.map((each) => h('li',
    { 'data-severity': each.severity, 'data-rule': each.rule }, `${symbols[each.severity]} ${sentence(each, state)}`));
  const list = byId('sentences-list');
  if (list.textContent !== items.map((item) => item.textContent).join('')) list.replaceChildren(...items);
  for (const name of LINE) setText(byId(`line-${name}`), number(state.line[name], 0));
}

/** What stands below is then no longer the present. */
function showLost(lost) {
  if (lost === null) return;
  const words = `no connection to the console: everything below is as it was at ${clock(lost)} UTC`;
  byId('sentences-list').replaceChildren(h('li', { 'data-severity': 'alarm' }, `${symbols.alarm} ${words}`));
}

const ROWS = { azimuth: 'azimuth', elevation: 'elevation', 'cross-elevation': 'cross_elevation', sigma: 'sigma', roll: 'roll' };

/** An offset in both units; `name` is the start of the ids: "offset" by the Sun, "gyro" by the gyros. */
function showOffset(name, offset) {
  for (const [id, field] of Object.entries(ROWS)) {
    const degrees = offset[`${field}_deg`] ?? null;
    const arcsec = offset[`${field}_arcsec`] ?? (degrees === null ? null : degrees * 3600);
    if (id !== 'roll') setText(byId(`${name}-${id}`), number(arcsec, 2));
    setText(byId(`${name}-${id}-deg`), number(degrees, id === 'roll' ? 4 : 6));
  }
  setText(byId(`${name}-quality`), offset.quality ?? '–');
  setText(byId(`${name}-time`), `${clock(offset.time, 2)} UTC`);
  setText(byId(`${name}-reason`), offset.reason ? `${symbols.attention} ${offset.reason}` : '');
  if (name === 'gyro') setText(byId('gyro-age'), offset.age_ms === null ? '–' : duration(offset.age_ms));
}

// ---- the Sun on the plate

const fetchPlate = paced(1000, () => reporting(byId('plate-error'), async () => {
  const plate = await getSvg(url('/api/plate.svg', { at: at() }));
  byId('plate').replaceChildren(plate || 'where the Sun is on the plate is not known');
}));

// ---- pictures, one figure per camera

const cameras = new Map();

function makeCamera(number) {
  const [image, words, error] = [h('img', { alt: '', hidden: true }), h('p', { class: 'received' }), h('p', { class: 'error' })];
  const fetchIt = h('button', {}, 'Fetch');
  const frame = h('a', {}, 'open the frame');
  const tags = h('dl', { class: 'tags' });
  const figure = h('figure', { 'data-camera': number }, h('figcaption', {}, words, fetchIt, frame, error), image,
    h('details', {}, h('summary', {}, 'tags'), tags));
  const camera = { image, words, frame, tags, fetchIt, figure, picture: null };
  camera.refresh = paced(500, () => reporting(error, () => fetchPicture(camera)));
  fetchIt.addEventListener('click', camera.refresh);
  byId('picture').append(figure);
  cameras.set(number, camera);
  return camera;
}

async function fetchPicture({ image, picture }) {
  const complete = picture.received >= picture.pixels;
  const overlay = byId('overlay').checked && complete ? 1 : null;
  await showPicture(image, url('/api/picture.png', { camera: picture.camera, at: at(), overlay, version: picture.version }));
  if (byId('overlay').checked && !complete) throw new Error('the overlay comes when the picture is complete');
}

function takePicture(picture) {
  const camera = cameras.get(picture.camera) ?? makeCamera(picture.camera);
  camera.picture = picture;
  byId('no-picture').hidden = true;
  const missing = picture.pixels - picture.received;
  const rows = Math.ceil(missing / picture.width);
  const nothing = picture.pixels === 0 && !picture.file;
  const state = nothing ? `${symbols.attention} no pixels yet` : missing === 0 ? `${symbols.good} complete`
    : `${symbols.attention} missing ${number((100 * missing) / picture.pixels, 1)} % (${rows} of ${picture.height} rows)`;
  setText(camera.words, `${picture.name} · ${picture.time ? `${dateTime(picture.time)} UTC` : 'time not known'} · ${state}`);
  camera.image.alt = `last picture of the ${picture.name}`;
  camera.figure.dataset.received = picture.received;
  camera.figure.dataset.pixels = picture.pixels;
  camera.fetchIt.hidden = !thin() || nothing;
  camera.frame.hidden = !picture.file;
  camera.frame.href = `/frames#file=${encodeURIComponent(picture.file)}`;
  camera.tags.replaceChildren(...Object.entries(picture.tags ?? {}).map(([name, { value, comment }]) =>
    h('div', {}, h('dt', {}, name), h('dd', {}, number(value)), h('dd', {}, comment ?? ''))));
  if (!thin() && !nothing) camera.refresh();
}

// ---- housekeeping

const values = new Map();

function buildHousekeeping() {
  if (values.size) return;
  byId('housekeeping').replaceChildren(...flight.fields.filter(({ table }) => table === 'housekeeping').map((field) => {
    const value = h('dd', { class: 'value', 'data-field': field.name }, '–');
    values.set(field.name, value);
    return h('div', { 'data-search': `${field.name} ${field.unit} ${field.documentation}`.toLowerCase() },
      h('dt', {}, field.name), value, h('dd', { class: 'unit' }, field.unit), h('dd', { class: 'meaning' }, field.documentation));
  }));
  filter();
}

function filter() {
  const words = byId('filter').value.toLowerCase().split(/\s+/);
  for (const item of byId('housekeeping').children) item.hidden = !words.every((word) => item.dataset.search.includes(word));
}

function showHousekeeping({ time, fields, gyros_against_sun: gyros }) {
  const severity = SEVERITIES[fields.gyro_agreement ?? 0];
  setText(byId('gyro-agreement'), gyros ? `${symbols[severity]} ${gyros}` : '');
  byId('gyro-agreement').dataset.severity = severity;
  setText(byId('housekeeping-time'), `at ${dateTime(time)} UTC`);
  for (const [name, place] of values) setText(place, number(fields[name]));
}

// ---- all together

function clear() {
  for (const kind of Object.keys(newest)) delete newest[kind];
  for (const { figure } of cameras.values()) figure.remove();
  cameras.clear();
  byId('no-picture').hidden = false;
  byId('plate').replaceChildren();
  byId('plate-fetch').hidden = !thin();
  for (const cell of document.querySelectorAll('.numbers td[id], #housekeeping .value')) setText(cell, '–');
}

function build() {
  for (const name of ['offset', 'gyro']) {
    byId(name).tBodies[0].append(...Object.keys(ROWS).map((id) =>
      row(id === 'sigma' ? 'sigma, each axis' : id, [id === 'roll' ? null : `${name}-${id}`, `${name}-${id}-deg`])));
  }
  byId('ages').tBodies[0].append(...Object.keys(OLD_S).map((kind) => row(kind, [`age-${kind}`])));
  byId('packets').tBodies[0].append(...LINE.map((name) => row(name.replaceAll('_', ' '), [`line-${name}`])));
  byId('overlay').checked = kept.get('overlay', false);
}

build();
byId('filter').addEventListener('input', filter);
byId('plate-fetch').addEventListener('click', fetchPlate);
byId('overlay').addEventListener('change', (event) => {
  kept.set('overlay', event.target.checked);
  for (const camera of cameras.values()) camera.refresh();
});
on('flight', buildHousekeeping);
on('view', clear);
on('state', showSentences);
on('connection', showLost);
on('solution', (solution) => {
  newest.solution = solution;
  showOffset('offset', solution);
  if (!thin()) fetchPlate();
});
on('propagated', (propagated) => {
  newest.propagated = propagated;
  showOffset('gyro', propagated);
});
on('housekeeping', (housekeeping) => {
  newest.housekeeping = housekeeping;
  showHousekeeping(housekeeping);
});
on('picture', (picture) => {
  newest.picture = picture;
  takePicture(picture);
});
watchTraining();
setInterval(showAges, 250);
begin();
byId('plate-fetch').hidden = !thin();
