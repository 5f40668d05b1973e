// The header of every page: where one is, how the flight is, what is shown, and the alarms.
import { watchAlarms } from './alarms.js';
import { post, reporting } from './api.js';
import { byId, clock, dateTime, h, parseUtc, sentence, setText, symbols } from './dom.js';
import { choices, flight, isLive, learn, select, on, serverNow, start, thin, viewNow } from './view.js';

const SPEEDS = [1, 2, 10, 60, 600];
const PAGES = [['/', 'Now'], ['/plots', 'Plots'], ['/commands', 'Commands'], ['/frames', 'Frames']];

function option(value, text, selected) { return h('option', { value, selected }, text); }

function build() {
  const links = PAGES.map(([path, name]) =>
    h('a', { href: path, id: `nav-${name.toLowerCase()}`, 'aria-current': location.pathname === path && 'page' }, name));
  byId('header').append(
    h('div', { class: 'bar' },
      h('strong', {}, 'solaspect'), h('nav', { 'aria-label': 'Pages' }, ...links),
      h('span', { id: 'source', class: 'grow' }),
      h('span', { id: 'viewers' }),
      h('label', {}, 'line ', h('select', { id: 'line', onchange: (event) => select({ bits: Number(event.target.value) || null }) },
        option('', 'full', !thin()), option('6000', '6 kb/s', thin()))),
      h('label', {}, h('input', { id: 'sound', type: 'checkbox' }), ' alarm sound', h('span', { id: 'sound-note' })),
      h('a', { id: 'recording', href: '/api/recording', download: true, hidden: true }, 'recording'),
      h('button', { id: 'login', hidden: true, onclick: logInOrOut }, 'Log in')),
    h('p', { id: 'state', role: 'status', 'aria-live': 'polite' }, 'connecting to the console'),
    h('form', { class: 'bar', id: 'time', 'aria-label': 'Time of the view', onsubmit: goTo },
      h('output', { id: 'mode', for: 'pause live go speed' }), h('output', { id: 'view' }), h('span', { id: 'utc' }),
      h('span', { class: 'grow' }),
      h('button', { id: 'pause', type: 'button', onclick: pauseOrPlay }, 'Pause'),
      h('label', {}, 'speed ', h('select', { id: 'speed', onchange: (event) => select({ speed: Number(event.target.value) }) },
        ...SPEEDS.map((speed) => option(speed, `${speed}×`, speed === choices.speed)))),
      h('label', {}, 'go to UTC ', h('input', { id: 'go-time', size: 20, autocomplete: 'off', placeholder: 'HH:MM:SS',
        oninput: (event) => event.target.setCustomValidity('') })),
      h('button', { id: 'go' }, 'Go'),
      h('button', { id: 'live', type: 'button', onclick: () => select({ at: null, playing: false }) }, 'Back to live')),
    h('p', { id: 'left-out', class: 'note', hidden: true }));
  document.body.append(loginDialog());
  // Its hash would take the place of what the address keeps.
  document.querySelector('.skip').addEventListener('click', (event) => {
    event.preventDefault();
    byId('main').focus();
  });
}

function loginDialog() {
  return h('dialog', { id: 'login-dialog', 'aria-labelledby': 'login-title' },
    h('form', { onsubmit: logIn },
      h('h2', { id: 'login-title' }, 'Log in'),
      // Password managers want a name beside the secret.
      h('input', { autocomplete: 'username', value: 'ground', hidden: true, 'aria-label': 'name' }),
      h('label', {}, 'Token ', h('input', { id: 'token', type: 'password', autocomplete: 'current-password', required: true })),
      h('p', { id: 'login-error', class: 'error', role: 'alert' }),
      h('div', { class: 'bar' }, h('button', { id: 'login-send', class: 'primary' }, 'Log in'),
        h('button', { type: 'button', onclick: () => byId('login-dialog').close() }, 'Cancel'))));
}

async function logInOrOut() {
  if (!flight.logged_in) return byId('login-dialog').showModal();
  await post('/api/logout').catch(() => {});
  await afterLogin();
}

function logIn(event) {
  event.preventDefault();
  reporting(byId('login-error'), async () => {
    await post('/api/login', { token: byId('token').value });
    byId('token').value = '';
    byId('login-dialog').close();
    await afterLogin();
  });
}

/** Where even viewing needs the login, everything starts over. */
async function afterLogin() {
  if (flight.needs_login) location.reload();
  else await learn();
}

function pauseOrPlay() {
  if (choices.playing || isLive()) select({ at: new Date(viewNow()).toISOString(), playing: false });
  else select({ at: choices.at ?? flight.begins, playing: true });
}

function goTo(event) {
  event.preventDefault();
  const input = byId('go-time');
  const time = parseUtc(input.value, viewNow());
  input.setCustomValidity(Number.isNaN(time) ? 'a UTC time, as 18:04:05 or 2013-09-21 18:04:05' : '');
  if (input.reportValidity()) select({ at: new Date(time).toISOString() });
}

function showFlight() {
  setText(byId('source'), `${flight.source}${flight.instrument ? ` · ${flight.instrument}` : ''}`);
  byId('source').title = `solaspect ${flight.version}`;
  byId('nav-frames').toggleAttribute('data-off', !flight.frames);
  byId('nav-commands').toggleAttribute('data-off', !flight.commands);
  byId('recording').hidden = !flight.recording;
  byId('login').hidden = !flight.commands && !flight.needs_login;
  setText(byId('login'), flight.logged_in ? 'Log out' : 'Log in');
  byId('go-time').title = flight.begins && flight.ends ? `${dateTime(flight.begins)} to ${dateTime(flight.ends)}` : '';
  showMode();
  if (flight.needs_login && !flight.logged_in) {
    sayState('attention', 'log in to see this flight');
    byId('login-dialog').showModal();
  }
}

function showMode() {
  const latest = flight.live ? 'Live' : 'End of the archive';
  const mode = choices.at === null ? latest : choices.playing ? `Replay ${choices.speed}×` : 'Paused';
  setText(byId('mode'), mode);
  byId('time').dataset.mode = choices.at === null ? 'latest' : 'past';
  setText(byId('pause'), choices.playing || isLive() ? 'Pause' : 'Play');
  setText(byId('live'), flight.live ? 'Back to live' : 'To the end');
  byId('live').disabled = choices.at === null;
  if (!thin()) byId('left-out').hidden = true;
}

function sayState(severity, words) {
  const place = byId('state');
  place.dataset.severity = severity;
  setText(place, `${symbols[severity]} ${words}`);
}

/** The worst sentence; Now shows them all. */
function showState(state) {
  const [worst, ...others] = state.sentences;
  const more = others.length ? ` · and ${others.length} more` : '';
  sayState(state.severity, `${sentence(worst, state)}${more}`);
  setText(byId('viewers'), state.viewers === 1 ? '1 viewer' : `${state.viewers} viewers`);
}

function showLost(lost) {
  if (lost !== null) sayState('alarm', `no connection to the console since ${clock(lost)} UTC; trying again`);
}

function tick() {
  setText(byId('utc'), `now ${dateTime(serverNow())} UTC`);
  const view = byId('view');
  view.hidden = isLive();
  if (!view.hidden) setText(view, `at ${dateTime(viewNow())} UTC, not the present`);
}

/** Builds the header and begins. `present`: this page always shows the present. */
export function begin({ present = false } = {}) {
  build();
  if (present) byId('time').title = 'this page always shows the flight as it is now';
  for (const control of present ? byId('time').querySelectorAll('button, input, select') : []) control.disabled = true;
  on('flight', showFlight);
  on('view', showMode);
  on('state', showState);
  on('connection', showLost);
  on('left_out', ({ words }) => {
    byId('left-out').hidden = false;
    setText(byId('left-out'), words);
  });
  watchAlarms();
  setInterval(tick, 250);
  return start(present);
}
