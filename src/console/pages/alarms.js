// Alarms that each viewer must acknowledge. An unacknowledged alarm stays, also after it has ended.
import { byId, h, kept, setText, since, symbols } from './dom.js';
import { isLive, on, serverNow, viewNow } from './view.js';

/** By id. What a replay shows is dropped with it; what was live is kept for the next page. */
let known = new Map();
let lost = null, audio = null;
const title = document.title;

const acknowledged = () => new Set(kept.get('acknowledged', []));
const waiting = () => [...known.values()].filter(({ id }) => !acknowledged().has(id));

function take(alarms) {
  const listed = new Set(alarms.map(({ id }) => id));
  const fresh = alarms.some(({ id }) => !known.has(id) && !acknowledged().has(id));
  for (const alarm of alarms) known.set(alarm.id, alarm);
  for (const [id, alarm] of known) {
    if (!listed.has(id) && alarm !== lost && alarm.until === null) alarm.until = new Date(viewNow()).toISOString();
    if (alarm.until !== null && acknowledged().has(id)) known.delete(id);
  }
  if (isLive()) kept.set('alarms', [...known.values()]);
  show();
  if (fresh) beep();
}

/** The loss of the console itself is an alarm, too; only this page can know it. */
function takeConnection(time) {
  if (lost !== null) lost.until = new Date(serverNow()).toISOString();
  lost = time === null ? null : {
    id: `connection@${time}`, rule: 'connection', severity: 'alarm', until: null,
    words: 'no connection to the console', since: new Date(time).toISOString(),
  };
  take([...known.values(), ...(lost ? [lost] : [])]);
}

function acknowledge(id) {
  kept.set('acknowledged', [...acknowledged().add(id)].slice(-500));
  take([...known.values()]);
}

function draw(alarm, done) {
  const list = byId('alarms-list');
  let item = list.querySelector(`[data-alarm="${CSS.escape(alarm.id)}"]`);
  if (!item) {
    item = h('li', { 'data-alarm': alarm.id, 'data-severity': alarm.severity }, h('span', { class: 'grow' }),
      h('button', { class: 'acknowledge', onclick: () => acknowledge(alarm.id) }, 'Acknowledge'));
    list.prepend(item);
  }
  const end = alarm.until === null ? '' : `, ended ${since(alarm.until, viewNow())}`;
  const note = done ? ' · acknowledged' : '';
  setText(item.firstChild, `${symbols[alarm.severity]} ${alarm.words}, since ${since(alarm.since, viewNow())}${end}${note}`);
  item.dataset.acknowledged = done;
  item.lastChild.hidden = done;
}

/** Changes only what differs, so that nothing is read aloud twice and no button vanishes under the finger. */
function show() {
  const done = acknowledged();
  for (const item of [...byId('alarms-list').children]) if (!known.has(item.dataset.alarm)) item.remove();
  for (const alarm of [...known.values()].sort((a, b) => a.since.localeCompare(b.since))) draw(alarm, done.has(alarm.id));
  const count = waiting().length;
  document.title = count ? `✕ ${count} ${title}` : title;
}

/** A browser allows sound only after a click or a key on the page. */
function beep() {
  const wanted = kept.get('sound', false) && waiting().length > 0;
  const allowed = navigator.userActivation?.hasBeenActive ?? true;
  setText(byId('sound-note'), wanted && !allowed ? ' (click on the page to allow it)' : '');
  if (!wanted || !allowed) return;
  audio ??= new AudioContext();
  const [tone, volume] = [audio.createOscillator(), audio.createGain()];
  tone.frequency.value = 880;
  volume.gain.value = 0.2;
  tone.connect(volume).connect(audio.destination);
  tone.start();
  tone.stop(audio.currentTime + 0.2);
}

function listen(event) {
  kept.set('sound', event.target.checked);
  beep();
}

export function watchAlarms() {
  byId('header').append(h('section', { id: 'alarms', 'aria-label': 'Alarms' },
    h('ul', { id: 'alarms-list', 'aria-live': 'assertive' })));
  const recall = () => {
    known = new Map(isLive() ? kept.get('alarms', []).map((alarm) => [alarm.id, alarm]) : []);
    if (lost) known.set(lost.id, lost);
    show();
  };
  byId('sound').checked = kept.get('sound', false);
  byId('sound').addEventListener('change', listen);
  on('flight', recall);
  on('view', recall);
  on('state', ({ alarms }) => take(alarms));
  on('connection', takeConnection);
  // Another tab of this viewer has acknowledged.
  window.addEventListener('storage', show);
  setInterval(beep, 10000);
}
