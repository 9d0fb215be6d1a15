// The look of a page, and what all pages do with plots and tables.

const COLORS = ['#0072B2', '#D55E00', '#000000', '#56B4E9', '#882255', '#999933'];
const LEFT = 58;  // pixels
const RIGHT = 12;
const TOP = 40;
const BOTTOM = 44;
const CONFIG = {
  responsive: true, displaylogo: false, displayModeBar: true, doubleClick: 'reset',
  // these alone: one of the others sends the data to a server
  modeBarButtons: [['zoom2d', 'pan2d', 'zoomIn2d', 'zoomOut2d', 'resetScale2d', 'toImage']],
};
const GREY = '#8c959f';
const LAYOUT = {
  font: {family: 'system-ui, sans-serif', size: 12, color: '#1f2328'}, showlegend: false,
  hovermode: 'closest', paper_bgcolor: '#fff', plot_bgcolor: '#fff',
  dragmode: matchMedia('(pointer: coarse)').matches ? false : 'zoom',  // a finger scrolls
};
const AXIS = {gridcolor: '#eaeef2', zeroline: false, exponentformat: 'e', nticks: 8};
const WIDE = 6;  // pixels between samples at which they are drawn as points
const HELP = 'Drag over a plot to zoom, double-click to see all; on a touch screen use the buttons '
  + 'above it.';
const facts = JSON.parse(document.getElementById('facts').textContent);

/** Return the width of what a plot draws in, in pixels. */
function bins(id) {
  return Math.max(document.getElementById(id).clientWidth - LEFT - RIGHT, 100);
}

/** Draw a plot, and again whenever it is zoomed or gets another size. */
function begin(id, layout, draw) {
  draw(layout);
  const plot = document.getElementById(id);
  plot.on('plotly_relayout', () => draw(plot.layout));
}

/** Fill a table with rows of texts: heads, then values; rows of values that differ stand out. */
function fillTable(id, rows, compare = false) {
  const table = document.getElementById(id);
  rows.forEach((cells, number) => {
    const isHead = number === 0 || cells.length === 1;
    const row = table.insertRow();
    row.classList.toggle('differs', compare && !isHead && new Set(cells.slice(1)).size > 1);
    for (const cell of cells) {
      const made = isHead ? row.appendChild(document.createElement('th')) : row.insertCell();
      // a name may break after each of its words
      for (const part of cell.split(/(?<=_)/)) made.append(part, document.createElement('wbr'));
      if (cells.length === 1) made.colSpan = rows[0].length;
    }
  });
}

/** Load the library of the plots from the page. */
async function loadPlotly() {
  const script = document.createElement('script');
  script.textContent = new TextDecoder().decode(await inflated('plotly'));
  document.head.append(script);
}

/** Show the page by what it does, and say when it is shown, or why it cannot be. */
function show(page) {
  const status = document.getElementById('status');
  page().then(() => {
    status.textContent = `impulse_control_ros ${facts.version}. ${HELP}`;
    document.body.dataset.ready = 'yes';
  }).catch((error) => {
    status.textContent = `The page cannot be shown: ${error.message}`;
    console.error(error);
  });
}
