// The page of commands: one form for all of them, made from the server's list; compose, arm, send; and the log.
import { getJson, paced, post, reporting } from './api.js';
import { byId, clock, dateTime, h, number, setText, since, symbols } from './dom.js';
import { begin } from './header.js';
import { flight, learn, on, serverNow, thin } from './view.js';

let list = { computers: [], commands: [], parameters: [] };
let command = null;
/** What was composed or armed; any change of the form undoes it. */
let composed = null, armed = null, edition = 0;

// ---- choosing

function showList() {
  const words = byId('search').value.toLowerCase().split(/\s+/);
  const found = list.commands.filter(({ name, documentation }) =>
    words.every((word) => `${name} ${documentation}`.toLowerCase().includes(word)));
  byId('command').replaceChildren(...found.map(({ name, documentation }) =>
    h('option', { value: name, title: documentation, selected: name === command?.name }, `${name}: ${documentation}`)));
}

/** Opens the form of a command; `values` by the names of its variables. */
function choose(name, values = {}) {
  command = list.commands.find((each) => each.name === name);
  undo();
  byId('form').hidden = false;
  byId('command').value = name;
  setText(byId('form-title'), command.key ? `${command.name} (${command.key})` : command.name);
  const reads = command.reads ? ` It reads ${command.reads.name}${command.reads.unit ? `, ${command.reads.unit}` : ''}.` : '';
  setText(byId('documentation'), `${command.documentation}.${reads}`);
  setText(byId('changes'), command.changes_flight ? `${symbols.attention} It changes the flight.` : '');
  byId('variables').replaceChildren(...command.variables.map((variable) => variableRow(variable, values[variable.name] ?? '')));
  const parameter = byId('variables').querySelector('select');
  if (parameter) {
    parameter.addEventListener('change', showParameter);
    showParameter();
  }
}

// ---- the form

/** set_float and its like have the parameters of their kind; the server numbers them. */
const parametersOf = ({ name }) => list.parameters.filter((parameter) => name.endsWith(`_${parameter.command}`));

function variableRow(variable, value) {
  const id = `value-${variable.name}`;
  const numbered = variable.name === 'parameter' && parametersOf(command).length > 0;
  const input = numbered
    ? h('select', { id }, ...parametersOf(command).map((each) =>
      h('option', { value: each.number, selected: String(each.number) === String(value) }, `${each.key} (${each.number})`)))
    : h('input', { id, value, required: true, inputmode: 'decimal', autocomplete: 'off', 'aria-describedby': `${id}-range`, oninput: check });
  const [present, range] = [h('span', { class: 'present', id: `present-${variable.name}` }), h('span', { class: 'range', id: `${id}-range` })];
  if (!numbered) {
    setText(range, variable.range);
    Object.assign(input.dataset, { low: variable.low, high: variable.high, range: variable.range });
    setText(present, presentWords(variable.present));
  }
  const read = variable.read_by && h('button', { type: 'button', class: 'read', onclick: () => readIt(variable.read_by) }, 'read it');
  return h('div', { class: 'variable', 'data-variable': variable.name },
    h('label', { for: id }, variable.name), h('span', { class: 'bar' }, input, variable.unit, present, read ?? ''), range);
}

function presentWords(present) {
  if (!present) return 'present value not known';
  return `now ${number(present.value)} (${present.from}, ${since(present.time, serverNow())})`;
}

/** Range, unit and default of the chosen parameter, beside its value. */
function showParameter() {
  const [parameter, value] = [byId('value-parameter'), byId('value-value')];
  const chosen = list.parameters.find((each) => String(each.number) === parameter.value);
  setText(byId('value-parameter-range'), chosen.documentation);
  if (!value) return;
  const range = `${chosen.low} to ${chosen.high}${chosen.unit ? ` ${chosen.unit}` : ''}, default ${chosen.default}`;
  Object.assign(value.dataset, { low: chosen.low, high: chosen.high, range });
  setText(byId('value-value-range'), range);
  // The present value is another for each parameter.
  setText(byId('present-value'), '');
}

/** The server checks, too; this only says it earlier. */
function check({ target }) {
  const value = Number(target.value);
  const bad = Number.isNaN(value) || value < Number(target.dataset.low) || value > Number(target.dataset.high);
  target.setCustomValidity(bad && target.value !== '' ? target.dataset.range : '');
  target.ariaInvalid = String(bad);
}

const values = () => [...byId('variables').querySelectorAll('input, select')].map((input) => input.value.trim());

/** Composes the command that reads this variable, of the same parameter if it has one. */
function readIt(name) {
  choose(name, { parameter: byId('value-parameter')?.value });
  compose();
}

// ---- compose, arm, send

function showComposed(answer) {
  composed = answer;
  byId('composed').hidden = answer === null;
  setText(byId('words'), answer?.words ?? '');
  setText(byId('bytes'), answer?.bytes.replace(/../g, '$& ').trim() ?? '');
  allow();
}

/** Which buttons may be pressed now. */
function allow() {
  byId('arm').disabled = composed === null || !flight.logged_in || armed !== null;
  byId('arm').title = flight.logged_in ? '' : 'log in to arm';
  byId('send').disabled = armed === null;
  if (composed !== null && !flight.logged_in) setText(byId('countdown'), 'log in to arm and send');
  else if (armed === null) setText(byId('countdown'), '');
}

function undo() {
  edition += 1;
  armed = null;
  byId('confirm').close();
  setText(byId('command-error'), '');
  showComposed(null);
}

/** Asks about the form as it stands; the answer counts only if the form is still the same. */
function ask(step, use) {
  const mine = edition;
  reporting(byId('command-error'), async () => {
    try {
      const answer = await post(`/api/commands/${step}`, { name: command.name, values: values(), computer: Number(byId('computer').value) });
      if (mine === edition) use(answer);
    } catch (error) {
      if (error.status === 401) learn().catch(() => {});
      throw error;
    }
  });
}

function compose() {
  undo();
  ask('compose', showComposed);
}

function arm() {
  ask('arm', (answer) => {
    armed = { ...answer, until: performance.now() + answer.expires_s * 1000 };
    showComposed(armed);
    countDown();
  });
}

function countDown() {
  if (armed === null) return;
  const left = Math.ceil((armed.until - performance.now()) / 1000);
  if (left <= 0) {
    undo();
    return setText(byId('countdown'), 'no longer armed: the time has passed');
  }
  setText(byId('countdown'), `armed: ${left} s left to send`);
  setText(byId('confirm-countdown'), `${left} s left`);
}

/** A command that changes the flight is asked about once more, in the words of what is sent. */
function send() {
  if (!armed.changes_flight) return sendArmed();
  setText(byId('confirm-words'), armed.words);
  setText(byId('confirm-documentation'), `It will ${command.documentation}.`);
  byId('confirm').showModal();
}

function sendArmed() {
  const { armed: id, changes_flight: confirmed } = armed;
  undo();
  reporting(byId('command-error'), async () => takeRow(await post('/api/commands/send', { armed: id, confirmed })));
}

// ---- the log

const rows = new Map();

function mark({ good, words }) {
  if (good === true) return ['good', `${symbols.good} good`];
  if (good === false) return ['alarm', `${symbols.alarm} not good`];
  return words ? ['attention', symbols.attention] : ['', '… waiting'];
}

function takeRow(row) {
  const [severity, judged] = mark(row);
  const time = (utc) => (utc ? clock(utc, 1) : '–');
  const result = [judged, row.result, row.words].filter(Boolean).join(' · ');
  const element = h('tr', { 'data-number': row.number, 'data-severity': severity },
    h('td', {}, row.number), h('td', {}, dateTime(row.utc)),
    h('td', {}, row.command, ' ', h('code', {}, row.bytes)), h('td', {}, row.computer),
    h('td', { class: 'log-received' }, time(row.received)), h('td', { class: 'log-answered' }, time(row.answered)),
    h('td', { class: 'log-result' }, result));
  if (rows.has(row.number)) rows.get(row.number).replaceWith(element);
  else byId('log').tBodies[0].prepend(element);
  rows.set(row.number, element);
}

// ---- all together

function showPossible() {
  byId('possible').hidden = !flight.commands;
  byId('impossible').hidden = flight.commands;
  setText(byId('impossible-words'), flight.live
    ? 'This console was started without a token, or no line leads from it to the gondola. Start it with: solaspect console --token-file FILE and the port of the line. FILE holds a secret of your own, readable by you alone; log in here with it.'
    : 'This console shows what was recorded; nothing can be sent to it. To command a flight, start the console on its line: solaspect console --token-file FILE and the port.');
  allow();
}

/** The present values, again: after an answer and when a command is chosen. */
const refresh = paced(1000, () => reporting(byId('log-error'), async () => {
  list = await getJson('/api/commands');
  const variables = list.commands.find(({ name }) => name === command?.name)?.variables ?? [];
  if (byId('value-parameter')) return;
  for (const variable of variables) setText(byId(`present-${variable.name}`), presentWords(variable.present));
}));

async function loadCommands() {
  list = await getJson('/api/commands');
  byId('computer').replaceChildren(...list.computers.map((computer) => h('option', { value: computer }, computer)));
  byId('computers').hidden = list.computers.length < 2;
  showList();
}

byId('search').addEventListener('input', showList);
byId('command').addEventListener('change', ({ target }) => {
  choose(target.value);
  if (!thin()) refresh();
});
byId('form').addEventListener('input', undo);
byId('form').addEventListener('submit', (event) => {
  event.preventDefault();
  compose();
});
byId('arm').addEventListener('click', arm);
byId('send').addEventListener('click', send);
byId('confirm-no').addEventListener('click', () => byId('confirm').close());
byId('confirm-yes').addEventListener('click', () => { if (armed) sendArmed(); });
setInterval(countDown, 250);
on('flight', showPossible);
on('answer', (row) => {
  takeRow(row);
  if (row.good && !thin()) refresh();
});
await begin({ present: true });
if (flight.commands) {
  reporting(byId('command-error'), loadCommands);
  reporting(byId('log-error'), async () => { for (const row of (await getJson('/api/commands/log')).rows.reverse()) takeRow(row); });
}
