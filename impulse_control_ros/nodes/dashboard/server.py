"""
The web server of the page: tornado, served between the turns of the ROS executor.

By default it answers only requests for the names of this machine, so no page of another host can
reach the nodes by DNS rebinding. Other hosts need a token: in the address, then in a cookie. A
browser requests a frame when it has drawn the last one, so a slow or hidden page gets fewer frames
and none is queued.
"""

import asyncio
from collections.abc import Callable, Mapping
import hmac
import json
from pathlib import Path
from time import monotonic
from typing import Any

from bokeh.util.paths import bokehjs_path
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from impulse_control_ros.errors import UsageError
from impulse_control_ros.nodes.dashboard.plots import plots

PAGE = Path(__file__).with_name('page')
FRAME = 0.2  # s between frames
COOKIE = 'dashboard_token'
LOCAL_NAMES = r'127\.0\.0\.1|localhost|\[?::1\]?'
REPORT = r'/reports/(dashboard_[\w-]+\.html)'
POLICY = (
    "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; frame-ancestors 'none'"
)
Answer = Callable[[Mapping[str, Any]], None]


class Guarded(RequestHandler):
    """Refuses requests without the token, if there is one."""

    def prepare(self) -> None:
        """Check the token; one in the address is kept in a cookie."""
        token = self.settings['token']
        given = self.get_query_argument('token', '')
        known = given or self.get_cookie(COOKIE, '') or ''
        if token and not hmac.compare_digest(known.encode(), token.encode()):
            raise HTTPError(403, reason='the token is missing or wrong: use the printed address')
        if token and given:
            self.set_cookie(COOKIE, token, httponly=True, samesite='strict')


class Page(Guarded):
    """The page, with the elements of its plots."""

    def get(self) -> None:
        """Send it."""
        self.set_header('Content-Security-Policy', POLICY)
        self.set_header('Cache-Control', 'no-store')
        self.render(str(PAGE / 'page.html'), plots=self.settings['plots'])


class Script(Guarded):
    """The script that draws the plots."""

    def get(self) -> None:
        """Send it."""
        self.set_header('Content-Type', 'text/javascript')
        self.set_header('Cache-Control', 'no-store')
        self.write(self.settings['script'])


class Files(Guarded, StaticFileHandler):
    """Files of the page and of Bokeh, and reports."""


class Socket(Guarded, WebSocketHandler):
    """One browser window, which asks for frames and sends requests."""

    def open(self, *_: str) -> None:
        """Begin."""
        self.seen: dict[str, Any] = {}
        self.wants_since: float | None = None
        self.sent_at = 0.0
        self.settings['sockets'].add(self)

    def on_message(self, message: str | bytes) -> None:
        """Take a request; the answer has its ``id``."""
        request = json.loads(message)
        if request.get('frame'):
            self.wants_since = monotonic()
            return
        number = request.pop('id', None)
        self.settings['ask'](request, lambda answer: self.send({'id': number, **answer}))

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message, unless the window is gone."""
        try:
            sent = self.write_message(json.dumps(message, allow_nan=False))
        except WebSocketClosedError:
            self.on_close()
        else:
            # asyncio logs an exception that nobody reads; a window may close during the transfer
            sent.add_done_callback(lambda one: one.cancelled() or one.exception())

    def on_close(self) -> None:
        """Forget the window."""
        self.settings['sockets'].discard(self)


class Server:
    """
    Serves the page on ``host`` and ``port``; 0 is any free port. Raises `UsageError`.

    ``frame(seen)`` returns what is new for a window, whose memory is ``seen``; ``ask(request,
    answer)`` handles a request. ``reports`` is the folder of the reports.
    """

    def __init__(
        self,
        host: str,
        port: int,
        token: str,
        frame: Callable[[dict[str, Any]], Mapping[str, Any]],
        ask: Callable[[Mapping[str, Any], Answer], None],
        reports: Path,
    ) -> None:
        self._frame = frame
        self._sockets: set[Socket] = set()
        self._loop = asyncio.new_event_loop()
        asyncio.set_event_loop(self._loop)
        script, made = plots()
        handlers: list[Any] = [
            ('/', Page),
            ('/plots.js', Script),
            (r'/(page\.(?:js|css))', Files, {'path': str(PAGE)}),
            (r'/(bokeh(?:-widgets)?\.min\.js)', Files, {'path': str(bokehjs_path() / 'js')}),
            (REPORT, Files, {'path': str(reports.absolute())}),
            ('/socket', Socket),
        ]
        application = Application(
            token=token,
            sockets=self._sockets,
            ask=ask,
            plots=made,
            script=script,
            log_function=lambda _: None,
            websocket_ping_interval=20.0,
            websocket_max_message_size=10_000,
        )
        names = '.*' if token else LOCAL_NAMES
        application.add_handlers(f'({names})', handlers)
        self._server = HTTPServer(application)
        try:
            sockets = bind_sockets(port, host)
        except (OSError, OverflowError) as error:
            reason = getattr(error, 'strerror', None) or error
            raise UsageError(f'--host {host} --port {port}: {reason}') from None
        self._server.add_sockets(sockets)
        self.port: int = sockets[0].getsockname()[1]

    def serve(self, seconds: float) -> None:
        """Serve requests for ``seconds``, and send the frames that are due."""
        self._loop.call_later(seconds, self._loop.stop)
        self._loop.run_forever()
        now = monotonic()
        for socket in [*self._sockets]:
            if socket.wants_since is not None and now >= socket.sent_at + FRAME:
                socket.sent_at, socket.wants_since = now, None
                socket.send(self._frame(socket.seen))

    def close(self) -> None:
        """Close all connections."""
        self._server.stop()
        for socket in [*self._sockets]:
            socket.close(1001)
        self.serve(0.1)
        asyncio.set_event_loop(None)
        self._loop.close()
