// The page of an identified axis: what each of its plots draws.

const WORDS = {position: 'measured', simulated: 'simulated', error: 'measured - simulated'};
const arrays = {};

/** Return the layout of a plot with titles of its axes. */
function titled(x, y, more = {}) {
  return {...LAYOUT, margin: {l: LEFT + 12, r: RIGHT, t: TOP, b: BOTTOM}, ...more,
          xaxis: {...AXIS, title: {text: x}, ...more.xaxis},
          yaxis: {...AXIS, title: {text: y, standoff: 4}, ...more.yaxis}};
}

/** Return a layout over the time of the validation. */
function overTime(y) {
  const time = arrays.time;
  return titled('time [s]', y, {
    showlegend: true, legend: {orientation: 'h', x: 0, y: 1.1},
    xaxis: {range: [time[0], time[time.length - 1]]}});
}

/** Return what draws series over time, thinned to the pixels of the plot. */
function drawer(id, names) {
  return (layout) => {
    const [from, to] = layout.xaxis.range;
    const traces = names.map((name, number) => {
      const part = thinned(arrays.time, arrays[name], from, to, bins(id));
      return {x: part.x, y: part.y, name: WORDS[name], mode: 'lines', type: 'scatter',
              line: {color: COLORS[number], width: 1.4},
              hovertemplate: '%{y:.6g} at %{x:.6g} s'};
    });
    Plotly.react(id, traces, layout, CONFIG);
  };
}

/** Draw the friction force over the velocity, and the lines of the model. */
function drawFriction() {
  const {velocity, force} = arrays;
  const points = {x: Array.from(velocity), y: Array.from(force), name: 'windows', mode: 'markers',
                  type: 'scatter', marker: {size: 3, color: GREY},
                  hovertemplate: '%{y:.6g} N at %{x:.6g} m/s'};
  const fastest = velocity.reduce((most, one) => Math.max(most, Math.abs(one)), 0);
  const lines = facts.friction.map(([side, rest, d], number) => ({
    x: [0, side * fastest], y: [side * rest, side * (rest + d * fastest)], mode: 'lines',
    type: 'scatter', name: side > 0 ? 'v > 0' : 'v < 0',
    line: {color: COLORS[number], width: 2}}));
  Plotly.react('friction', [points, ...lines], titled('velocity [m/s]', 'force [N]'), CONFIG);
}

/** Draw d by block, one series a record, and its bound. */
function drawDamping() {
  const traces = facts.records.map((name, number) => {
    const at = Array.from(arrays.block_record.keys())
      .filter((i) => arrays.block_record[i] === number);
    const of = (array) => at.map((i) => array[i]);
    return {x: of(arrays.block_time), y: of(arrays.block_d), name, mode: 'markers',
            type: 'scatter', marker: {size: 5, color: COLORS[number % COLORS.length]},
            error_y: {type: 'data', array: of(arrays.block_error), thickness: 1, width: 0}};
  });
  const shapes = facts.d_bar === null ? [] : [
    {type: 'line', xref: 'paper', x0: 0, x1: 1, y0: facts.d_bar, y1: facts.d_bar,
     line: {color: COLORS[1], width: 2}}];
  const most = arrays.block_d.reduce((a, b) => Math.max(a, b), facts.d_bar ?? 0);
  const layout = titled('time [s]', 'd [N s/m]', {shapes, yaxis: {range: [0, 1.1 * most]}});
  Plotly.react('damping', traces, layout, CONFIG);
}

/** Draw the estimates over the length of the windows, relative to their errors. */
function drawSweep() {
  const {window: lengths, values, errors} = facts.sweep;
  const traces = Object.entries(values).map(([name, series], number) => ({
    x: lengths, y: series.map((value, k) => (value - series[0])
      / Math.max(errors[name][0], errors[name][k])), name,
    mode: 'lines+markers', type: 'scatter', line: {color: COLORS[number], width: 1.4}}));
  const layout = titled('window [s]', 'change in standard errors',
                        {showlegend: true, legend: {orientation: 'h', x: 0, y: 1.1}});
  Plotly.react('sweep', traces, layout, CONFIG);
}

/** Be the page. */
async function main() {
  await loadPlotly();
  for (const name of ['time', 'position', 'simulated', 'error', 'velocity', 'force', 'block_time',
                      'block_d', 'block_error']) {
    arrays[name] = await unpacked(name, Float32Array);
  }
  arrays.time = Float64Array.from(arrays.time, (time) => time + facts.validation.start);
  arrays.block_record = await unpacked('block_record', Uint32Array);
  fillTable('figures', facts.table);
  const list = document.getElementById('facts-list');
  for (const fact of facts.facts) {
    list.append(Object.assign(document.createElement('li'), {textContent: fact}));
  }
  const {name, seen, segment, rms} = facts.validation;
  document.getElementById('shown').textContent = `The last third of ${name}, which `
    + (seen ? 'the fit has seen, for the rest alone does not identify the axis' : 'the fit has not seen')
    + `. Simulated with the recorded effort, anew from the recorded state every ${segment} s. `
    + (rms === null ? 'No mass was identified.' : `Rms of the residual: ${rms.toPrecision(3)} m.`);
  begin('validation', overTime('position [m]'), drawer('validation', ['position', 'simulated']));
  begin('residual', overTime('residual [m]'), drawer('residual', ['error']));
  drawFriction();
  drawDamping();
  drawSweep();
}

show(main);
