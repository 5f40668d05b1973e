// The page of the archive's frames: a list by quality and reason, and one frame open.
import { getJson, showPicture, reporting, url } from './api.js';
import { byId, dateTime, h, kept, setText } from './dom.js';
import { begin } from './header.js';
import { at, flight, on } from './view.js';

const COUNT = 50;
/** The ends of the pages before this one; the last is that of this page. */
let pages = [null];
let shown = [], file = null;

function option(value, text, chosen) { return h('option', { value, selected: value === chosen }, text); }

function showCounts({ total, by_quality, by_reason }) {
  const [quality, reason] = [byId('quality').value, byId('reason').value];
  setText(byId('total'), `(${total})`);
  byId('quality').replaceChildren(option('', 'all', quality),
    ...Object.entries(by_quality).map(([name, count]) => option(name, `${name} (${count})`, quality)));
  byId('reason').replaceChildren(option('', 'all', reason),
    ...by_reason.map((each) => option(each.reason, `${each.reason} (${each.count})`, reason)));
}

function row(frame) {
  const open = h('button', { class: 'link', onclick: () => show(frame) }, dateTime(frame.utc, 2));
  return h('tr', { 'data-file': frame.file, 'aria-current': frame.file === file && 'true' },
    h('td', {}, open), h('td', {}, frame.camera), h('td', {}, frame.quality), h('td', {}, frame.reason ?? ''));
}

function load() {
  return reporting(byId('list-error'), async () => {
    const answer = await getJson(url('/api/frames', {
      quality: byId('quality').value, reason: byId('reason').value, before: pages.at(-1), count: COUNT,
    }));
    showCounts(answer);
    shown = answer.frames;
    byId('frames').tBodies[0].replaceChildren(...shown.map(row));
    byId('older').disabled = shown.length < COUNT;
    byId('newer').disabled = pages.length === 1;
  });
}

/** The newest page, up to the time of the view. */
function newest() {
  pages = [at()];
  return load();
}

function show(frame) {
  file = frame.file;
  history.replaceState(null, '', `#file=${encodeURIComponent(file)}`);
  byId('frame-box').hidden = false;
  setText(byId('frame-title'), frame.file);
  setText(byId('frame-row'), [frame.utc && `${dateTime(frame.utc, 3)} UTC`, frame.camera, frame.quality, frame.reason].filter(Boolean).join(' · '));
  byId('fits').href = url('/api/frame.fits', { file });
  for (const each of byId('frames').tBodies[0].rows) each.ariaCurrent = each.dataset.file === file ? 'true' : null;
  showFrame();
  // Where there is no space beside the list, the frame is far below it.
  if (byId('frame').getBoundingClientRect().top > innerHeight) byId('frame').scrollIntoView();
}

function showFrame() {
  const overlay = byId('overlay').checked ? 1 : null;
  return reporting(byId('frame-error'), () => showPicture(byId('frame-picture'), url('/api/frame.png', { file, overlay })));
}

for (const id of ['quality', 'reason']) byId(id).addEventListener('change', newest);
byId('newest').addEventListener('click', newest);
byId('newer').addEventListener('click', () => {
  pages.pop();
  load();
});
byId('older').addEventListener('click', () => {
  pages.push(shown.at(-1).utc);
  load();
});
byId('overlay').checked = kept.get('overlay', false);
byId('overlay').addEventListener('change', (event) => {
  kept.set('overlay', event.target.checked);
  if (file) showFrame();
});
on('view', () => { if (flight.frames) newest(); });
await begin();
if (flight.frames) {
  await newest();
  const named = new URLSearchParams(location.hash.slice(1)).get('file');
  if (named) show(shown.find((frame) => frame.file === named) ?? { file: named });
} else {
  setText(byId('list-error'), 'No frames here: this console was started without an archive. Pictures sent over the line are on the page Now.');
}
