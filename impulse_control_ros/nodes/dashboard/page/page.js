// The page: it draws frames, and sends what the form fields ask for.

const SAMPLES = 3000;  // drawn, as the server keeps
const IMPULSES = 2000;
const AGAIN = 1000;  // ms between attempts to connect
const COUNTED = /^(missed_deadlines|lost|rejected|withheld|late)$/;  // troubles, if not 0
const GUARDS = {position_zero: 'at e = 0', velocity_zero: 'at v = 0', sticking: 'while sticking'};
const element = (id) => document.getElementById(id);
const model = (name) => Bokeh.documents[0].get_model_by_name(name);
const waiting = new Map();  // what to do with an answer, by the number of its request
let socket, asked = 0, bands = {}, reports = {}, lastFrame;

// -- the connection ---------------------------------------------------------------------------

function connect() {
  socket = new WebSocket(`ws${location.protocol.slice(4)}//${location.host}/socket`);
  socket.onopen = () => { state('connected', false); want(); };
  socket.onmessage = (event) => take(JSON.parse(event.data));
  socket.onclose = () => {
    waiting.clear();
    state('connection lost, trying again', true);
    setTimeout(connect, AGAIN);
  };
}

function state(text, lost) {
  element('connection').textContent = text;
  element('connection').classList.toggle('lost', lost);
}

function want() {
  if (socket.readyState === WebSocket.OPEN) socket.send('{"frame": true}');
}

/** Send a request; `answered` gets its answer. */
function ask(request, answered) {
  if (socket.readyState !== WebSocket.OPEN) {
    answered({refused: 'not connected'});
    return;
  }
  waiting.set(++asked, answered);
  socket.send(JSON.stringify({id: asked, ...request}));
}

function take(message) {
  if (message.id !== undefined) {
    const answered = waiting.get(message.id);
    waiting.delete(message.id);
    answered?.(message);
    return;
  }
  requestAnimationFrame(want);  // a hidden page asks for nothing
  draw(message);
}

// -- what is drawn ----------------------------------------------------------------------------

/** Add rows to a source, or replace them. */
function stream(source, rows, fresh, most) {
  for (const name of Object.keys(rows)) {
    if (name !== 'guard') rows[name] = rows[name].map((value) => value ?? NaN);
  }
  if (fresh) source.data = rows;
  else if (rows.time.length) source.stream(rows, most);
}

function draw(frame) {
  lastFrame = frame;
  stream(model('samples'), frame.samples, frame.fresh, SAMPLES);
  stream(model('impulses'), frame.impulses, frame.fresh, IMPULSES);
  if (frame.parameters) drawParameters(frame);
  if (model('samples').data.time.length) drawBands();
  drawState(frame);
}

/** Set the dead bands: horizontal ones over time, the one of the position in the phase plane. */
function drawBands() {
  const {x_r: center, position_deadband: position, velocity_deadband: velocity} = bands;
  const visible = [center, position, velocity].every(Number.isFinite);
  const show = (name, ends) => model(name).setv(visible ? {visible, ...ends} : {visible});
  show('position_band', {bottom: center - position, top: center + position});
  show('velocity_band', {bottom: -velocity, top: velocity});
  show('phase_band', {left: -position, right: position});
}

/** Draw the PD effort, or the applied effort if the law is that of a foreign controller. */
function drawEffort(isKnown) {
  model('effort').visible = !isKnown;
  model('feedback').visible = isKnown;
  element('effort').textContent = isKnown ? 'PD effort, without impulses' : 'Applied effort';
}

/** Show rows of a name, a value and a class, unless they are shown already. */
function fill(table, rows) {
  const text = JSON.stringify(rows);
  if (table.dataset.rows === text) return;
  table.dataset.rows = text;
  table.replaceChildren(...rows.map(([name, value, kind = '']) => {
    const made = document.createElement('tr');
    made.className = kind;
    const head = made.appendChild(document.createElement('th'));
    head.scope = 'row';
    head.textContent = name;
    made.appendChild(document.createElement('td')).textContent = value;
    return made;
  }));
}

function number(value) {
  return Number.isFinite(value) ? Number(value.toPrecision(3)) : '';
}

/** Tell how often a guard has fired, and the time and the area of its last impulse. */
function fired(frame, guard) {
  const [time, area] = frame.last[guard] ?? [];
  return `${frame.fired[guard] ?? 0}${area === undefined ? '' : `, last at ${time.toFixed(3)} s: ${number(area)} N s`}`;
}

/** Return what the supervision has learnt; nothing of a foreign controller. */
function learnt(report, name, unit) {
  const value = report[`learnt_${name}`];
  if (value === undefined) return [];
  return [[`learnt ${name}`, value === 'nan' ? 'not yet' : `${Number(value)} ${unit}`]];
}

const isTrouble = (name, value) => COUNTED.test(name) && Number(value) > 0;

function drawState(frame) {
  if (frame.reports) {
    reports = frame.reports;
    drawReports();
  }
  const entries = Object.entries(reports);
  const [, controller = {}] = entries.find(([name]) => name.startsWith('controller')) ?? [];
  const missing = ['plant', 'controller'].filter((role) => !entries.some(([name]) => name.startsWith(role)));
  const troubles = entries.flatMap(([name, report]) => Object.entries(report)
    .filter(([key, value]) => isTrouble(key, value))
    .map(([key, value]) => `${name.split(' ')[0]}: ${value} ${key.replaceAll('_', ' ')}`));
  if (frame.lost) troubles.push(`${frame.lost} impulses lost on the way here`);
  fill(element('figures'), [
    ...missing.map((role) => [role, 'not found', 'error']),
    ...entries.map(([name, {message = '', level}]) => [name, message, level]),
    ['missed, lost or rejected', troubles.join('; ') || 'none', troubles.length ? 'counted' : ''],
    ['real-time factor', number(frame.speed)],
    ['impulses per second', number(frame.impulse_rate)],
    ...Object.keys(GUARDS).map((guard) => [`impulses ${GUARDS[guard]}`, fired(frame, guard)]),
    ...learnt(controller, 'mass', 'kg'),
    ...learnt(controller, 'delay', 's'),
  ]);
  const {running, state: said, report} = frame.recording;
  const record = element('record');
  record.textContent = running ? 'Stop recording' : 'Record';
  record.dataset.do = running ? 'stop' : 'record';
  record.setAttribute('aria-pressed', running);
  if (element('recording').dataset.shown !== said + report) {
    element('recording').dataset.shown = said + report;
    element('recording').textContent = said + (report ? ': ' : '');
    if (report) {
      const link = element('recording').appendChild(document.createElement('a'));
      link.href = `reports/${report}`;
      link.target = '_blank';
      link.textContent = 'report';
    }
  }
  element('undo').disabled = !frame.undo;
  element('undo').title = frame.undo ? `back to ${frame.undo}` : 'nothing was changed';
  document.body.dataset.time = model('samples').data.time.at(-1) ?? '';
  document.body.dataset.ready = 'yes';
}

/** Show all that the nodes say of themselves. */
function drawReports() {
  element('reports').replaceChildren(...Object.entries(reports).map(([name, report]) => {
    const table = document.createElement('table');
    table.createCaption().textContent = name;
    fill(table.createTBody(), Object.entries(report).map(
      ([key, value]) => [key.replaceAll('_', ' '), value, isTrouble(key, value) ? 'counted' : '']));
    return table;
  }));
}

// -- parameters -------------------------------------------------------------------------------

const fields = {plant: new Map(), controller: new Map()};

function drawParameters(frame) {
  for (const role of Object.keys(fields)) {
    const known = frame.parameters[role] ?? [];
    const shape = JSON.stringify(known.map(({value, ...rest}) => rest));
    if (fields[role].shape !== shape) build(role, known, shape);
    for (const one of known) fields[role].get(one.name).show(one.value);
  }
  bands = frame.bands;
  drawEffort(frame.knows_law);
  element('findings').replaceChildren(...frame.findings.map(([level, text]) => {
    const item = document.createElement('li');
    item.className = level.toLowerCase();
    item.textContent = `${level.toLowerCase()}: ${text}`;
    return item;
  }));
  if (!frame.findings.length) element('findings').textContent = 'none';
}

/** Make the form fields of a node; the set-point has its own place. */
function build(role, known, shape) {
  fields[role] = new Map();
  fields[role].shape = shape;
  element(role).replaceChildren();
  if (role === 'controller') element('setpoint').replaceChildren();
  for (const one of known) {
    const made = new Field(role, one);
    fields[role].set(one.name, made);
    (one.name === 'x_r' ? element('setpoint') : element(role)).append(made.element);
  }
}

/** The form field of a parameter: a slider and a text, a switch, or a choice. */
class Field {
  constructor(role, one) {
    this.role = role;
    this.one = one;
    this.element = document.createElement('div');
    this.element.className = 'field';
    this.element.dataset.name = `${role}.${one.name}`;
    const id = `${role}.${one.name}`;
    const label = this.add('label', {htmlFor: id, textContent: one.name});
    if (one.unit) {
      label.append(Object.assign(document.createElement('span'), {className: 'unit', textContent: ` ${one.unit}`}));
    }
    this.input = this.makeInput(id);
    if (one.kind === 'number' || one.kind === 'integer') this.addSlider();
    this.add('p', {className: 'about', textContent: one.description, id: `${id}.about`});
    this.refused = this.add('p', {className: 'refused', id: `${id}.refused`});
    this.refused.setAttribute('role', 'alert');
    this.input.setAttribute('aria-describedby', `${id}.about ${id}.refused`);
    this.input.title = one.read_only ? 'read-only: set where the node is started' : one.allowed;
    this.input.disabled = one.read_only || one.kind === 'list';
    this.input.addEventListener('change', () => this.send(this.text()));
  }

  add(tag, properties) {
    return this.element.appendChild(Object.assign(document.createElement(tag), properties));
  }

  makeInput(id) {
    if (this.one.kind === 'switch') {
      const made = this.add('input', {type: 'checkbox', id});
      made.setAttribute('role', 'switch');
      return made;
    }
    if (!this.one.choices.length) {
      return this.add('input', {type: 'text', id, autocomplete: 'off', spellcheck: false,
        inputMode: this.one.kind === 'number' ? 'decimal' : 'text'});
    }
    const made = this.add('select', {id});
    for (const choice of this.one.choices) made.append(new Option(choice, choice));
    return made;
  }

  /** A slider sends its value when it is let go, so that a pull is one change in the recording. */
  addSlider() {
    if (this.one.read_only || this.one.choices.length) return;
    this.slider = this.add('input', {type: 'range'});
    this.slider.setAttribute('aria-label', this.one.name);
    this.slider.addEventListener('input', () => { this.input.value = this.rounded(); });
    this.slider.addEventListener('change', () => this.send(this.rounded()));
  }

  rounded() {
    return String(Number(Number(this.slider.value).toPrecision(4)));
  }

  text() {
    return this.one.kind === 'switch' ? String(this.input.checked) : this.input.value;
  }

  send(text) {
    ask({do: 'set', role: this.role, name: this.one.name, text}, ({refused}) => {
      this.refused.textContent = refused;
      if (refused) this.shown = undefined;
    });
  }

  /** Show a value of the node, but not over what is being typed. */
  show(value) {
    if (value === this.shown) return;
    this.shown = value;
    if (this.one.kind === 'switch') this.input.checked = value;
    else if (this.one.choices.length) {
      this.input.value = this.one.choices.find((one) => one === String(value) || Number(one) === value);
    } else this.input.value = Array.isArray(value) ? value.join(', ') : String(value);
    this.refused.textContent = '';
    if (this.slider) this.move(value);
  }

  /** Let the slider reach from bound to bound, or about twice as far as the value. */
  move(value) {
    const {lower, upper} = this.one;
    const span = Math.max(2 * Math.abs(value), this.span ?? 0) || 1;
    if (!this.span || Math.abs(value) > this.span) this.span = span;
    const least = lower ?? -this.span;
    const most = upper ?? this.span;
    Object.assign(this.slider, {min: least, max: most, step: this.one.kind === 'integer' ? 1 : 'any'});
    this.slider.value = value;
  }
}

// -- buttons ----------------------------------------------------------------------------------

function say({refused, said}) {
  element('said').textContent = refused || said || '';
  element('said').classList.toggle('refused', Boolean(refused));
}

for (const button of document.querySelectorAll('button[data-do]')) {
  button.addEventListener('click', () => ask({do: button.dataset.do}, say));
}
element('save').addEventListener('submit', (event) => {
  event.preventDefault();
  ask({do: 'save', file: element('file').value}, say);
});

/** Give the plots the colours of the page, and again when these change. */
function paint() {
  const style = getComputedStyle(document.documentElement);
  const [ink, blue] = ['--quiet', '--blue'].map((name) => style.getPropertyValue(name).trim());
  for (const plot of Bokeh.documents[0].roots()) {
    for (const axis of [...plot.below, ...plot.left]) {
      axis.setv({
        axis_label_text_color: ink, major_label_text_color: ink, axis_line_color: ink,
        major_tick_line_color: ink, minor_tick_line_color: null,
      });
    }
    for (const {glyph} of plot.renderers) if (glyph.type === 'Line') glyph.line_color = blue;
  }
}

/** Begin once Bokeh has made the plots, which it does when the page is loaded. */
function begin() {
  if (!Bokeh.documents.length) {
    setTimeout(begin, 10);
    return;
  }
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', paint);
  paint();
  connect();
}

begin();
