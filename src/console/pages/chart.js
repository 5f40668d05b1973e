// A server's plot on the page: the times under its pixels, dragging over it, and saving it.
import { byId, h } from './dom.js';

/** The drawn SVG and the geometry of its panels, or null. */
function panels() {
  const svg = byId('drawing').firstElementChild;
  if (!svg?.dataset.from) return null;
  const [left, right] = [Number(svg.dataset.left), Number(svg.dataset.right)];
  return { svg, left, right, from: Date.parse(svg.dataset.from), to: Date.parse(svg.dataset.to), box: svg.getBoundingClientRect() };
}

/** The times of the left and right edge, in ms, or null. */
export function edges() {
  const { from, to } = panels() ?? {};
  return from === undefined ? null : { from, to };
}

/** The time under a pointer, and its x on the page's box of the plot; held within the panels. */
function under(event) {
  const { svg, left, right, from, to, box } = panels();
  const scale = box.width / svg.viewBox.baseVal.width;
  const x = Math.min(right, Math.max(left, (event.clientX - box.left) / scale));
  return { time: from + ((to - from) * (x - left)) / (right - left), x: x * scale + box.left - byId('plot').getBoundingClientRect().left };
}

/** `zoom(from, to)` is called after a drag, `point(ms or null)` while the pointer moves. */
export function watchPointer(zoom, point) {
  const [plot, selection] = [byId('plot'), byId('selection')];
  let begun = null;
  function draw(a, b) {
    selection.hidden = false;
    selection.style.left = `${Math.min(a, b)}px`;
    selection.style.width = `${Math.max(1, Math.abs(a - b))}px`;
  }
  function end() {
    begun = null;
    selection.hidden = true;
  }
  plot.addEventListener('pointerdown', (event) => {
    if (event.button !== 0 || !panels()) return;
    plot.setPointerCapture(event.pointerId);
    begun = under(event);
  });
  plot.addEventListener('pointermove', (event) => {
    if (!panels()) return;
    const here = under(event);
    draw(begun?.x ?? here.x, here.x);
    point(here.time);
  });
  plot.addEventListener('pointerup', (event) => {
    if (!begun) return;
    const [first, here] = [begun, under(event)];
    end();
    if (Math.abs(first.x - here.x) > 5) zoom(Math.min(first.time, here.time), Math.max(first.time, here.time));
  });
  plot.addEventListener('pointercancel', end);
  plot.addEventListener('pointerleave', () => {
    if (!begun) end();
    point(null);
  });
  plot.addEventListener('keydown', (event) => { if (event.key === 'Escape') end(); });
  /** While the pointer drags, the plot must not change under it. */
  return () => begun !== null;
}

function save(blob, name) {
  const address = URL.createObjectURL(blob);
  h('a', { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10000);
}

const svgBlob = (svg) => new Blob([new XMLSerializer().serializeToString(svg)], { type: 'image/svg+xml' });
export const saveSvg = (svg, name) => save(svgBlob(svg), `${name}.svg`);

/** At twice the size, so that it can be printed. */
export async function savePng(svg, name) {
  const { width, height } = svg.viewBox.baseVal;
  const image = new Image();
  image.src = URL.createObjectURL(svgBlob(svg));
  await image.decode();
  const canvas = h('canvas', { width: 2 * width, height: 2 * height });
  canvas.getContext('2d').drawImage(image, 0, 0, canvas.width, canvas.height);
  URL.revokeObjectURL(image.src);
  canvas.toBlob((blob) => save(blob, `${name}.png`));
}
