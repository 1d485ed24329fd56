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

// Charts: the server sends data, what follows makes options of ECharts from them. `colours` are the
// server's.
const PLAIN = { animation: false, textStyle: { fontFamily: 'inherit' } };
const LEGEND = { top: 0, right: 10, itemHeight: 8, textStyle: { fontSize: 11 } };
const LINE = { type: 'line', showSymbol: false, silent: true };

// The noise floor as a band around zero.
function noiseBand(floor) {
  const data = floor == null ? [] : [[{ yAxis: -floor }, { yAxis: floor }]];
  return { silent: true, itemStyle: { color: colours.band, opacity: 0.35 }, data };
}

// A symmetric range of an axis with five labels.
function around(limit) { return { min: -limit, max: limit, interval: limit / 2 }; }

// Grids and axes of panels beside each other with one scale of their vertical axis.
function beside(titles, name, limits, range) {
  const width = 94 / Math.max(titles.length, 1);
  return {
    grid: titles.map((_, k) => (
      { left: `${6 + k * width}%`, width: `${width - 2}%`, top: 30, bottom: 42 })),
    xAxis: titles.map((title, k) => ({
      type: 'value', gridIndex: k, scale: true, nameLocation: 'middle', nameGap: 22, name: title,
      splitNumber: 4, axisLine: { onZero: false }, ...range,
      axisLabel: { hideOverlap: true, fontSize: 10, showMaxLabel: false,
        showMinLabel: !range?.min } })),
    yAxis: titles.map((_, k) => ({
      type: 'value', scale: true, axisLine: { onZero: false }, nameGap: 36,
      nameLocation: 'middle', gridIndex: k, name: k ? '' : name, ...limits,
      axisLabel: { show: !k, fontSize: 10, hideOverlap: true } })),
  };
}

const CHARTS = {
  // Torques and error along a recording; of a compared model, too.
  'torque-plot': (d) => {
    const below = { ...LINE, xAxisIndex: 1, yAxisIndex: 1 };
    const x = { type: 'value', min: d.span[0], max: d.span[1] };
    const y = { type: 'value', scale: true, nameLocation: 'middle', nameGap: 40,
      axisLabel: { hideOverlap: true } };
    const names = ['measured', 'predicted', 'error'];
    if (d.other.predicted?.length) names.push('predicted (compared)', 'error (compared)');
    const leftOut = {
      silent: true, itemStyle: { color: '#b0b6bc', opacity: 0.35 }, emphasis: { disabled: true },
      label: { color: '#52606d', fontSize: 10 },
      data: d.excluded.map(([a, b]) => [{ xAxis: a, name: 'excluded' }, { xAxis: b }]) };
    const series = (id, name, color, data, width, more) => (
      { ...LINE, id, name, color, data: data ?? [], lineStyle: { width }, ...more });
    const compared = { color: colours.compared, lineStyle: { width: 1.2, type: 'dashed' } };
    return {
      grid: [{ left: 62, right: 14, top: 26, height: '42%' },
        { left: 62, right: 14, top: '58%', bottom: 54 }],
      legend: { ...LEGEND, data: names },
      xAxis: [{ ...x, gridIndex: 0, axisLabel: { show: false } },
        { ...x, gridIndex: 1, name: 'time [s]', nameLocation: 'middle', nameGap: 20,
          axisLabel: { hideOverlap: true, showMaxLabel: false }, axisLine: { onZero: false } }],
      yAxis: [{ ...y, gridIndex: 0, name: `torque [${d.unit}]`, splitNumber: 4 },
        { ...y, gridIndex: 1, name: `error [${d.unit}]`, splitNumber: 3 }],
      axisPointer: { link: [{ xAxisIndex: 'all' }] },
      dataZoom: [
        { type: 'inside', xAxisIndex: [0, 1], filterMode: 'none', moveOnMouseMove: false,
          zoomOnMouseWheel: true },
        { type: 'slider', xAxisIndex: [0, 1], filterMode: 'none', height: 16, bottom: 4,
          showDataShadow: false, brushSelect: false }],
      brush: { xAxisIndex: 'all', brushLink: 'all', toolbox: [], throttleType: 'debounce',
        throttleDelay: 100, outOfBrush: { colorAlpha: 1 } },
      toolbox: { show: false },
      series: [
        series('measured', 'measured', colours.measured, d.lines.measured, 2.4,
          { markArea: leftOut }),
        series('predicted', 'predicted', colours.predicted, d.lines.predicted, 1.3),
        series('error', 'error', colours.error, d.lines.error, 1.1,
          { ...below, markArea: noiseBand(d.noise) }),
        { ...below, id: 'cursor', data: [], markLine: cursor(d.time) },
        series('other', names[3], colours.compared, d.other.predicted, 1.3, compared),
        series('other error', names[4], colours.compared, d.other.error, 1.1,
          { ...below, ...compared }),
      ],
    };
  },

  // The error over each signal; forward and backward motion apart.
  'residual-plot': (d) => {
    const kinds = [['at rest', 'rest'], ['forward', 'forward'], ['backward', 'backward']];
    const values = d.panels.flatMap((p) => kinds.flatMap(([, key]) => p[key].map((xy) => xy[1])));
    const sizes = values.map(Math.abs).sort((a, b) => a - b);
    const inside = sizes[Math.floor(0.995 * sizes.length)] || 1;  // a few samples are outside
    const limit = 2 * Number((0.55 * inside).toPrecision(2));
    return {
      ...beside(d.panels.map((p) => `${p.title} [${p.unit}]`), `error [${d.unit}]`,
        around(limit)),
      legend: { ...LEGEND, data: ['forward', 'backward', 'at rest'] },
      series: d.panels.flatMap((p, k) => {
        const axes = { xAxisIndex: k, yAxisIndex: k, silent: true };
        const samples = kinds.map(([name, key]) => (  // large: one path for all, drawn much faster
          { ...axes, id: `${k} ${name}`, type: 'scatter', name, data: p[key], symbolSize: 3,
            symbol: 'rect', color: colours[key], itemStyle: { opacity: 0.45 }, large: true,
            largeThreshold: 100 }));
        samples[0].markArea = noiseBand(d.noise);
        const means = [['forward', 'solid'], ['backward', 'dashed']].map(([name, type]) => (
          { ...axes, id: `${k} mean ${name}`, type: 'line', name, data: p[`${name}_mean`],
            color: colours[name], z: 4, showSymbol: false, lineStyle: { width: 2.6, type } }));
        return [...samples, ...means];
      }),
    };
  },

  // Correlations of the error, and what noise gives.
  'correlation-plot': (d) => {
    const values = d.panels.flatMap((p) => p.values.map(([, y]) => Math.abs(y)));
    const limit = Math.max(Math.ceil(5 * values.reduce((a, b) => Math.max(a, b), 0)), 1) / 5;
    const bars = (p, k, name, color, use) => (
      { id: `${k} ${name}`, name, type: 'bar', xAxisIndex: k, yAxisIndex: k, barWidth: 3,
        barGap: '-100%', color, silent: true, data: p.values.filter(use) });
    return {
      ...beside(d.panels.map((p) => `${p.title}, lag [s]`), 'correlation',
        around(limit), { min: 'dataMin', max: 'dataMax' }),
      legend: { ...LEGEND, data: ['as noise', 'beyond noise'] },
      series: d.panels.flatMap((p, k) => [
        bars(p, k, 'beyond noise', colours.error, ([, y]) => Math.abs(y) > p.band),
        { ...bars(p, k, 'as noise', colours.predicted, ([, y]) => Math.abs(y) <= p.band),
          markArea: noiseBand(p.band) }]),
    };
  },

  'spectrum-plot': (d) => ({
    ...beside(['frequency [Hz]'], `RMS [${d.unit}]`, { min: 0 }, { max: 'dataMax' }),
    legend: { ...LEGEND, data: ['error', 'white noise of the noise floor'] },
    series: [
      { ...LINE, id: 'spectrum', name: 'error', color: colours.error, areaStyle: { opacity: 0.2 },
        data: d.values },
      { ...LINE, id: 'level', name: 'white noise of the noise floor', color: '#52606d',
        lineStyle: { type: 'dashed', width: 1.2 },
        data: d.level == null || !d.values.length ? []
          : [[0, d.level], [d.values.at(-1)[0], d.level]] },
    ],
  }),

  // Errors of models relative to those of the first one.
  waterfall: (d) => {
    const mark = (name, data, more) => (
      { id: name, type: 'scatter', name, data, z: 5, color: '#222222', ...more });
    return {
      animation: d.playing,
      animationDurationUpdate: 300,
      grid: { left: 46, right: 8, top: d.models.length > 2 ? 48 : 30, bottom: 34 },
      legend: { type: 'plain', top: 0, left: 0, itemWidth: 12, itemHeight: 8, itemGap: 8,
        textStyle: { fontSize: 11 } },
      tooltip: { trigger: 'axis' },
      xAxis: { type: 'category', data: d.models[0]?.errors.map((_, j) => `${j + 1}`) ?? [],
        name: 'joint', nameLocation: 'middle', nameGap: 20, axisLabel: { interval: 0 } },
      yAxis: { type: 'value', min: 0, name: 'error / that of the first model',
        nameLocation: 'middle', nameGap: 32 },
      series: [
        ...d.models.map(({ name, color, errors }, k) => (
          { id: `model ${k}`, type: 'bar', name, color, barGap: '8%', barMaxWidth: 40, data: errors })),
        mark('training', d.training, { symbol: 'diamond', symbolSize: 9,
          itemStyle: { color: 'white', borderColor: '#222222', borderWidth: 1.2 } }),
        mark('noise floor', d.noise, { symbol: 'rect', symbolSize: [26, 2] }),
      ],
    };
  },
};

function cursor(time) {
  return { symbol: 'none', animation: false, label: { show: false },
    lineStyle: { color: '#333333', type: 'solid' }, data: time == null ? [] : [{ xAxis: time }] };
}

// What each chart shows: its data, whether to forget what the user has changed, such as the zoom,
// and, once it is drawn, its number of panels and its options without the series.
const shown = new Map();

// Draw what has changed once the browser has made the chart and it is scrolled into view.
function draw(id, kind, data, whole) {
  if (!shown.has(id)) shown.set(id, { kind, data: {} });
  const kept = shown.get(id);
  Object.assign(kept.data, data);
  kept.whole ||= whole;
  const chart = getElement(id)?.chart;
  if (!chart) { setTimeout(() => draw(id, kind, {}, false), 20); return; }
  kept.seen ??= new IntersectionObserver((found) => {
    if (!found.at(-1).isIntersecting) return;
    kept.seen.disconnect();
    const options = { ...PLAIN, ...CHARTS[kept.kind](kept.data) };
    const panels = [options.grid].flat().length, notMerge = kept.whole || panels !== kept.panels;
    const { series, ...look } = options, known = notMerge ? {} : kept.look;
    const changed = Object.entries(look).filter(
      ([key, value]) => JSON.stringify(value) !== JSON.stringify(known[key]));
    const replaceMerge = ['series'];
    chart.setOption({ series, ...Object.fromEntries(changed) }, { notMerge, replaceMerge });
    if (notMerge && options.brush) startBrush(chart);
    Object.assign(kept, { panels, look, whole: false });
  }, { rootMargin: '100px' });
  kept.seen.disconnect();
  kept.seen.observe(chart.getDom());
}

function moveCursor(id, time) {
  const kept = shown.get(id);
  kept.data.time = time;
  const series = [{ id: 'cursor', markLine: cursor(time) }];
  if (kept.panels) getElement(id)?.chart?.setOption({ series });
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

// Draw a scene when it has changed only, not at each look of its timer: without a graphics card that
// would take the processor from the fit.
function drawChanges(id) {
  const { renderer, text_renderer: flat, text3d_renderer: deep } = getElement(id) ?? {};
  if (!deep) { setTimeout(() => drawChanges(id), 20); return; }
  const drawAll = renderer.render.bind(renderer);
  let drawn = '';
  renderer.render = (scene, camera) => {
    const state = [renderer.domElement.width, renderer.domElement.height];
    for (const root of [camera, scene]) {
      root.traverse(({ id: number, visible, position, quaternion, material }) => state.push(
        number, visible, ...position, ...quaternion, material?.color?.getHex()));
    }
    const now = state.map((x) => Number(x).toFixed(5)).join();  // the camera moves by rounding errors
    if (now === drawn) return;
    drawn = now;
    drawAll(scene, camera);
  };
  flat.render = deep.render = () => {};  // texts, of which there are none
}

// Dragging on a chart selects.
function startBrush(chart) {
  const brushOption = { brushType: 'lineX', brushMode: 'single' };
  chart.dispatchAction({ type: 'takeGlobalCursor', key: 'brush', brushOption });
}
