// The panel of the demo: its faults on buttons, with what each does, what the console shows of it, and what to do.
import { post, reporting } from './api.js';
import { byId, h, setText, symbols } from './dom.js';
import { flight, learn, on } from './view.js';

const PARTS = [['happens', 'What happens'], ['shows', 'What the console shows'], ['remedy', 'What to do']];
const buttons = new Map();

function press(button) {
  const on = button.ariaPressed !== 'true';
  reporting(byId('training-error'), async () => {
    try {
      show(await post('/api/training', { fault: button.value, on }));
    } catch (error) {
      if (error.status === 401) learn().catch(() => {});
      throw error;
    }
  });
}

/** Names of fields stand in backquotes. */
const withCode = (text) => text.split('`').map((part, n) => (n % 2 ? h('code', {}, part) : part));

function draw({ fault, title, ...texts }) {
  const button = h('button', { value: fault, id: `fault-${fault}`, onclick: () => press(button) }, title);
  const words = PARTS.flatMap(([part, name]) => [h('dt', {}, name), h('dd', {}, ...withCode(texts[part]))]);
  byId('exercises').append(h('li', {}, h('p', { class: 'bar' }, button, h('span', { id: `fault-${fault}-state` })),
    h('details', {}, h('summary', {}, 'what to expect, and what to do'), h('dl', {}, ...words))));
  buttons.set(fault, button);
}

function show(exercises) {
  byId('training').hidden = false;
  for (const exercise of exercises) {
    if (!buttons.has(exercise.fault)) draw(exercise);
    buttons.get(exercise.fault).ariaPressed = String(exercise.on);
    setText(byId(`fault-${exercise.fault}-state`), exercise.on ? `${symbols.attention} on: press again to end it` : 'off');
  }
  allow();
}

/** Who may command may train. */
function allow() {
  for (const button of buttons.values()) button.disabled = !flight.logged_in;
  setText(byId('training-note'), flight.logged_in ? 'Press a button to put the fault on, and again to take it off.'
    : flight.commands ? 'Log in to put a fault on.' : 'This console was started without --token-file: faults cannot be put on.');
}

export function watchTraining() {
  on('training', show);
  on('flight', allow);
}
