// The page: what is drawn, in which colour, and what a click or a zoom does to it.

const GUARDS = {
  position_zero: {words: 'impulse at e = 0', color: '#CC79A7', symbol: 'circle'},
  velocity_zero: {words: 'impulse at v = 0', color: '#009E73', symbol: 'diamond'},
  sticking: {words: 'impulse while sticking', color: '#E69F00', symbol: 'square'},
};
const FAILED = {words: 'impulse not confirmed', color: '#CF222E', symbol: 'x-thin'};
const SUSPENDED = {words: 'impulses suspended', color: '#CF222E'};
const MARKED = ['position', 'velocity', 'impulse'];  // panels that show the impulses
const PANEL = 150;
const GAP = 34;
const hidden = new Set();  // names of runs, guards, 'failed' and 'suspended'

// -- what was recorded ------------------------------------------------------------------------

/** Return a run with its samples. */
async function loaded(fact, number) {
  const get = (name, Kind) => unpacked(`${number}.${name}`, Kind);
  const run = {...fact, color: COLORS[number % COLORS.length]};
  run.time = Float64Array.from(await get('time', Uint32Array), (tick) => tick * fact.unit);
  for (const name of ['error', 'velocity', 'impulse', 'rest', 'damping']) {
    run[name] = await get(name, Float32Array);
  }
  run.damping_time = Float64Array.from(
    await get('damping_at', Uint32Array), (at) => run.time[at]);
  for (const name of ['setpoint', 'position', 'feedback']) {
    run[name] = new Float64Array(fact.count);
  }
  fact.settings.forEach((setting, at) => {
    const end = fact.settings[at + 1]?.first ?? fact.count;
    for (let i = setting.first; i < end; i++) {
      const limit = setting.effort_limit || Infinity;
      const braking = setting.D ? setting.D * run.velocity[i] : 0;
      const law = -setting.K * run.error[i] - braking;
      run.setpoint[i] = setting.x_r;
      run.position[i] = run.error[i] + setting.x_r;
      const known = Number.isFinite(law) ? Math.min(Math.max(law, -limit), limit) : 0;
      run.feedback[i] = known + run.rest[i];
    }
  });
  const fired = await get('fired', Uint32Array);
  const guard = await get('guard', Uint32Array);
  run.fired = {};
  for (const name of Object.keys(GUARDS)) {
    run.fired[name] = fired.filter((_, i) => facts.guards[guard[i]] === name);
  }
  run.failed = await get('failed', Uint32Array);
  const ends = Array.from(await get('suspended', Uint32Array), (at) => run.time[at]);
  run.suspended = ends.flatMap((from, i) => (i % 2 ? [] : [[from, ends[i + 1]]]));
  return run;
}

/** Return the times and the values of what a panel shows. */
function series(run, key) {
  return key === 'damping' ? [run.damping_time, run.damping] : [run.time, run[key]];
}

// -- over time --------------------------------------------------------------------------------

/** Tell whether any run has a finite value of what a panel shows. */
function isKnown(key) {
  return runs.some((run) => series(run, key)[1].some(Number.isFinite));
}

/** Return the panels that have anything to show. */
function panels() {
  return Object.keys(facts.panels).filter(isKnown);
}

/** Return the layout of the panels, one below the other on one axis of time. */
function timeLayout() {
  const count = panels().length;
  const height = count * PANEL + (count - 1) * GAP;
  document.getElementById('time').style.height = `${height + TOP + BOTTOM}px`;
  const layout = {
    ...LAYOUT, margin: {l: LEFT, r: RIGHT, t: TOP, b: BOTTOM}, annotations: [],
    xaxis: {...AXIS, range: [-0.01 * end(), 1.01 * end()], anchor: `y${count}`,
            title: {text: 'time [s]'}},
  };
  panels().forEach((key, number) => {
    const top = 1 - number * (PANEL + GAP) / height;
    layout[`yaxis${number + 1}`] = {...AXIS, nticks: 5, domain: [top - PANEL / height, top]};
    layout.annotations.push({
      text: `<b>${facts.panels[key]}</b>`, xref: 'paper', x: 0, xanchor: 'left', yref: 'paper', y: top,
      yanchor: 'bottom', showarrow: false});
  });
  return layout;
}

/** Return when the last of the runs ends [s]. */
function end() {
  return Math.max(...runs.map((run) => run.time[run.count - 1]));
}

/** Draw what the axis of time shows, and say whether these are all samples. */
function drawTime(layout) {
  const [from, to] = layout.xaxis.range;
  const traces = [];
  let count = 0;
  let all = true;
  panels().forEach((key, number) => {
    const axis = {xaxis: 'x', yaxis: `y${number + 1}`};
    for (const run of runs.filter((one) => !hidden.has(one.name))) {
      const part = thinned(...series(run, key), from, to, bins('time'));
      if (key === 'position') {
        traces.push({...setpointLine(run, from, to), ...axis});
        count += part.count;
        all = all && part.all;
      }
      traces.push({
        ...part, ...axis, name: run.name, meta: key, type: 'scatter',
        mode: WIDE * part.count < bins('time') ? 'lines+markers' : 'lines', marker: {size: 4},
        line: {color: run.color, width: 1.4}, hovertemplate: '%{y:.6g} at %{x:.6g} s'});
      if (MARKED.includes(key)) {
        const marks = [...guardMarks(run, key, from, to), ...failedMarks(run, key, from, to)];
        traces.push(...marks.map((one) => ({...one, ...axis})));
      }
    }
  });
  layout.shapes = suspensions();
  Plotly.react('time', traces, layout, CONFIG);
  document.getElementById('shown').textContent = all
    ? `All ${count.toLocaleString('en')} samples of this span are drawn.`
    : `${count.toLocaleString('en')} samples, drawn by the least and the largest of each pixel; `
      + 'zoom in to see each.';
}

/** Return the line of the set-point. */
function setpointLine(run, from, to) {
  return {...thinned(run.time, run.setpoint, from, to, bins('time')), name: 'x_r', mode: 'lines',
          meta: 'setpoint', hoverinfo: 'skip', type: 'scatter',
          line: {color: GREY, width: 1, dash: 'dash', shape: 'hv'}};
}

/** Return the impulses of each guard as points on a series. */
function guardMarks(run, key, from, to) {
  return shownGuards(run).map((name) => {
    const part = pointsAt(run, key, run.fired[name], from, to);
    return {...part, name, meta: key, mode: 'markers', type: 'scatter',
            marker: mark(name, 4 * part.x.length < bins('time') ? 7 : 3),
            hovertemplate: `${GUARDS[name].words}<br>%{y:.6g} at %{x:.6g} s`};
  });
}

/** Return the points of a series at some samples, thinned. */
function pointsAt(run, key, at, from, to) {
  const times = Float64Array.from(at, (i) => run.time[i]);
  const values = Float32Array.from(at, (i) => run[key][i]);
  return thinned(times, values, from, to, bins('time'));
}

/** Return the impulses that were not confirmed as crosses on a series. */
function failedMarks(run, key, from, to) {
  if (!run.failed.length || hidden.has('failed')) return [];
  const {words, color, symbol} = FAILED;
  return [{...pointsAt(run, key, run.failed, from, to), name: 'failed', meta: key,
           mode: 'markers', type: 'scatter',
           marker: {symbol, color, size: 11, line: {color, width: 2}},
           hovertemplate: `${words}<br>%{y:.6g} at %{x:.6g} s`}];
}

/** Return the spans of time in which impulses were suspended, as shades. */
function suspensions() {
  if (hidden.has('suspended')) return [];
  return runs.filter((run) => !hidden.has(run.name)).flatMap(
    (run) => run.suspended.map(([x0, x1]) => ({
      type: 'rect', layer: 'below', xref: 'x', x0, x1, yref: 'paper', y0: 0, y1: 1,
      fillcolor: SUSPENDED.color, opacity: 0.08, line: {width: 0}})));
}

/** Return the guards with impulses in a run that are not hidden. */
function shownGuards(run) {
  return Object.keys(GUARDS).filter((name) => run.fired[name].length && !hidden.has(name));
}

/** Return the look of a guard's points. */
function mark(name, size) {
  return {color: GUARDS[name].color, symbol: GUARDS[name].symbol, size, line: {width: 0}};
}

// -- in the phase plane -----------------------------------------------------------------------

/** Return the least and the largest value over all runs of those that a test lets pass. */
function extent(key, test = () => true) {
  let low = Infinity;
  let high = -Infinity;
  for (const run of runs) {
    for (let i = 0; i < run.count; i++) {
      if (!test(run, i) || !Number.isFinite(run[key][i])) continue;
      low = Math.min(low, run[key][i]);
      high = Math.max(high, run[key][i]);
    }
  }
  const room = 0.05 * (high - low) || 0.05 * Math.abs(high) || 1e-6;
  return low > high ? [-1, 1] : [Math.min(low, 0) - room, Math.max(high, 0) + room];
}

/** Return the names of the phase planes; without a velocity there are none. */
function planes() {
  return isKnown('velocity') ? ['phase', 'near'] : [];
}

/** Return the ranges of the whole plane, and of a hundredth of it around e = 0. */
function ranges() {
  const whole = {x: extent('error'), y: extent('velocity')};
  const close = Math.max(-whole.x[0], whole.x[1]) / 100;
  const isClose = (run, i) => Math.abs(run.error[i]) < close;
  return {phase: whole, near: {x: [-close, close], y: extent('velocity', isClose)}};
}

/** Return the layout of a phase plane that shows the given ranges. */
function phaseLayout({x, y}) {
  const line = {type: 'line', layer: 'below', line: {color: GREY, width: 1.5}};
  const note = {showarrow: false, font: {color: '#57606a', size: 11}};
  return {
    ...LAYOUT, margin: {l: LEFT, r: RIGHT, t: TOP, b: BOTTOM},
    xaxis: {...AXIS, nticks: 6, range: x, title: {text: 'error e [m]'}},
    yaxis: {...AXIS, range: y, title: {text: 'velocity v [m/s]', standoff: 4}},
    shapes: [{...line, x0: 0, x1: 0, yref: 'paper', y0: 0, y1: 1},
             {...line, y0: 0, y1: 0, xref: 'paper', x0: 0, x1: 1}],
    annotations: [
      {...note, text: 'e = 0', x: 0, yref: 'paper', y: 0, xanchor: 'left', yanchor: 'bottom'},
      {...note, text: 'v = 0', y: 0, xref: 'paper', x: 1, xanchor: 'right', yanchor: 'bottom'}]};
}

/** Draw what a phase plane shows. */
function drawPhase(id, layout) {
  const box = {x: layout.xaxis.range, y: layout.yaxis.range, width: bins(id),
               height: document.getElementById(id).clientHeight - TOP - BOTTOM};
  const traces = [];
  for (const run of runs.filter((one) => !hidden.has(one.name))) {
    const line = path(run.error, run.velocity, box);
    traces.push({...line, name: run.name, type: 'scatter', marker: {size: 4},
                 mode: WIDE * line.x.length < box.width ? 'lines+markers' : 'lines',
                 line: {color: run.color, width: 1.4},
                 hovertemplate: 'e = %{x:.6g} m<br>v = %{y:.6g} m/s'});
    for (const name of shownGuards(run)) {
      const {x, y} = jumps(run.error, run.velocity, run.fired[name], box);
      const size = x.map((_, i) => (i % 3 ? 0 : 7));  // at the beginning of each line alone
      traces.push({x, y, name, mode: 'lines+markers', type: 'scatter', hovertemplate:
                   `${GUARDS[name].words}<br>e = %{x:.6g} m<br>v = %{y:.6g} m/s`,
                   marker: mark(name, size), line: {color: GUARDS[name].color, width: 1}});
    }
  }
  Plotly.react(id, traces, layout, CONFIG);
}

// -- the legend and the tables ----------------------------------------------------------------

/** Fill the legend: a button for each run, and for what is marked in any. */
function fillLegend() {
  const legend = document.getElementById('legend');
  for (const run of runs) legend.append(button(run.name, run.name, 'line', run.color));
  for (const [name, {words, color, symbol}] of Object.entries(GUARDS)) {
    const count = runs.reduce((sum, run) => sum + run.fired[name].length, 0);
    if (count) {
      legend.append(button(name, `${words} (${count.toLocaleString('en')})`, symbol, color));
    }
  }
  for (const [name, {words, color}] of Object.entries({failed: FAILED, suspended: SUSPENDED})) {
    const count = runs.reduce((sum, run) => sum + run[name].length, 0);
    if (count) legend.append(button(name, `${words} (${count})`, 'square', color));
  }
}

/** Return a button that hides what has that name, and shows it again. */
function button(name, text, shape, color) {
  const made = document.createElement('button');
  const sign = document.createElement('i');
  sign.className = shape;
  sign.style.background = color;
  made.append(sign, text);
  made.dataset.name = name;
  made.setAttribute('aria-pressed', 'true');
  made.addEventListener('click', () => {
    if (!hidden.delete(name)) hidden.add(name);
    made.setAttribute('aria-pressed', String(!hidden.has(name)));
    drawAll();
  });
  return made;
}

/** Return rows with a column for each run, of the texts by name that each gives. */
function byRun(textsOf) {
  const columns = runs.map(textsOf);
  const names = new Set(columns.flatMap((column) => Object.keys(column)));
  return [...names].map((name) => [name, ...columns.map((column) => column[name] ?? '')]);
}

/** Return the rows of the parameters of all nodes, and of their changes in a run. */
function parameterRows() {
  const nodes = new Set(runs.flatMap((run) => Object.keys(run.parameters)));
  const rows = [];
  for (const node of nodes) rows.push([node], ...byRun((run) => run.parameters[node] ?? {}));
  runs.forEach((run, number) => run.changes.forEach(([when, node, values]) => {
    rows.push([`${node}, from ${when} on`]);
    for (const [name, value] of Object.entries(values)) {
      rows.push([name, ...runs.map((_, at) => (at === number ? value : ''))]);
    }
  }));
  return rows;
}

// -- all of it --------------------------------------------------------------------------------

const runs = [];

/** Draw the plots again as they are zoomed now. */
function drawAll() {
  drawTime(document.getElementById('time').layout);
  for (const id of planes()) drawPhase(id, document.getElementById(id).layout);
}

/** Be the page. */
async function main() {
  await loadPlotly();
  for (const [number, fact] of facts.runs.entries()) runs.push(await loaded(fact, number));
  fillLegend();
  fillTable('figures', facts.table);
  const head = ['', ...runs.map((run) => run.name)];
  fillTable('parameters', [head, ...parameterRows()], true);
  fillTable('provenance', [head, ...byRun((run) => run.provenance)]);
  begin('time', timeLayout(), drawTime);
  const range = ranges();
  for (const id of planes()) begin(id, phaseLayout(range[id]), (layout) => drawPhase(id, layout));
  if (!planes().length) document.querySelectorAll('.phase').forEach((one) => one.remove());
}

show(main);
