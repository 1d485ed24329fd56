// What the browser does with the page: parts of lists, dropped files, charts.

// A click, enter or space on a part of a list emits its action.
function emitAction(event, emit) {
  const part = event.target.closest('[data-action], a, summary');
  if (!part?.dataset.action) return;
  if (event.type === 'keydown') event.preventDefault();  // space would scroll
  emit(part.dataset.action);
}

// A list that is drawn again keeps the focus on the part with the same action.
let acted = null;
addEventListener('focusin', (event) => {
  const part = event.target.closest('[data-action]');
  acted = part && { list: part.closest('.parts'), action: part.dataset.action };
});
addEventListener('pointerdown', (event) => {
  if (!event.target.closest('[data-action]')) acted = null;
});
new MutationObserver(() => {
  if (!acted || document.activeElement !== document.body) return;
  const same = acted.list?.querySelector(`[data-action="${CSS.escape(acted.action)}"]`);
  same?.focus({ preventScroll: true });
}).observe(document, { childList: true, subtree: true });

// Files that are dropped anywhere on the page go to the field for files.
function acceptDrops(id) {
  addEventListener('dragover', (event) => event.preventDefault());
  addEventListener('drop', (event) => {
    if (event.defaultPrevented) return;  // on the field itself
    event.preventDefault();  // of showing the file in place of the page
    getElement(id).$refs.qRef.addFiles(event.dataTransfer.files);
  });
}

// Options of a chart, once the browser has made it. One that cannot be seen is drawn when it is
// scrolled into view.
function draw(id, options, whole) {
  const chart = getElement(id)?.chart;
  if (!chart) { setTimeout(() => draw(id, options, whole), 20); return; }
  const place = chart.getDom();
  const later = place.later;
  if (!later || whole) place.later = { options, whole };
  else {
    const known = new Map((later.options.series ?? []).map((s) => [s.id, s]));
    for (const s of options.series ?? []) known.set(s.id, { ...known.get(s.id), ...s });
    const series = known.size ? { series: [...known.values()] } : {};
    place.later = { options: { ...later.options, ...options, ...series }, whole: later.whole };
  }
  place.seen ??= new IntersectionObserver((found) => {
    if (!found.at(-1).isIntersecting) return;
    const { options, whole } = place.later;
    chart.setOption(options, whole);
    if (whole && options.brush) startBrush(chart);
    place.later = null;
    place.seen.disconnect();
  }, { rootMargin: '100px' });
  place.seen.disconnect();
  place.seen.observe(place);
}

// A click on a chart emits its horizontal coordinate.
function emitClicks(id, event) {
  const chart = getElement(id)?.chart;
  if (!chart) { setTimeout(() => emitClicks(id, event), 20); return; }
  chart.getZr().on('click', (click) => {
    const [x] = chart.convertFromPixel({ gridIndex: 0 }, [click.offsetX, click.offsetY]);
    getElement(id).$emit(event, x);
  });
}

// Dragging on a chart selects.
function startBrush(chart) {
  const brushOption = { brushType: 'lineX', brushMode: 'single' };
  chart.dispatchAction({ type: 'takeGlobalCursor', key: 'brush', brushOption });
}
