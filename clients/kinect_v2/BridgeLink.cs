// Sends the frames of a spool to `mocapella node bridge` until they are acknowledged; docs/wire.md has the protocol.
using System;
using System.Globalization;
using System.IO;
using System.Net.Sockets;
using System.Text;
using System.Threading;

namespace Mocapella.KinectV2
{
    /// <summary>Connects, and connects again, until all frames of a spool are acknowledged and no more come.</summary>
    public sealed class BridgeLink
    {
        private const int RetryMs = 1000, HereEveryMs = 10000, DeadAfterMs = 40000, SendTimeoutMs = 10000;

        private readonly string host, sensor;
        private readonly int port;
        private readonly Action<string> say;
        private readonly Action onNoBridge;
        private string lastSaid = "";

        /// <summary>Number of times that the bridge ended the connection with a reason.</summary>
        public int Refusals { get; private set; }
        /// <summary>Frames that were lost before the bridge had them, as it was told.</summary>
        public long Lost { get; private set; }

        /// <param name="onNoBridge">Called when nothing listens at the address.</param>
        public BridgeLink(string host, int port, string sensor, Action<string> say, Action onNoBridge)
        {
            this.host = host;
            this.port = port;
            this.sensor = sensor;
            this.say = say;
            this.onNoBridge = onNoBridge;
        }

        /// <summary>Deliver a spool; return whether everything was acknowledged and the sensor has left.</summary>
        /// <param name="ending">Returns whether the spool gets no further frame.</param>
        /// <param name="giveUp">Returns whether to end now, with frames left in the spool; its argument is the number
        /// of the first frame that is not acknowledged.</param>
        public bool Deliver(Spool spool, Func<bool> ending, Func<long, bool> giveUp)
        {
            while (!giveUp(spool.Acknowledged))
            {
                try
                {
                    using (var client = new TcpClient())
                    {
                        client.Connect(host, port);
                        client.NoDelay = true;
                        client.SendTimeout = SendTimeoutMs;
                        var talk = new Talk(this, spool, client.Client, ending, giveUp);
                        if (talk.Run()) return true;
                    }
                }
                catch (SocketException error)
                {
                    bool refused = error.SocketErrorCode == SocketError.ConnectionRefused;
                    if (refused) onNoBridge();
                    string why = refused ? "" : " (" + error.Message + ")";
                    Once("no bridge at " + host + ":" + port + why + "; frames are kept in " + spool.Folder);
                }
                catch (IOException error)
                {
                    Once(error.Message);
                }
                if (giveUp(spool.Acknowledged)) return false;
                Thread.Sleep(RetryMs);
            }
            return false;
        }

        private void Once(string text)
        {
            if (text == lastSaid) return;
            lastSaid = text;
            say(text);
        }

        /// <summary>One connection.</summary>
        private sealed class Talk
        {
            private readonly BridgeLink link;
            private readonly Spool spool;
            private readonly Socket socket;
            private readonly Func<bool> ending;
            private readonly Func<long, bool> giveUp;
            private readonly StringBuilder text = new StringBuilder();
            private long sendNext, window, heardMs, spokenMs;
            private bool ended, saidEnd;

            public Talk(BridgeLink link, Spool spool, Socket socket, Func<bool> ending, Func<long, bool> giveUp)
            {
                this.link = link;
                this.spool = spool;
                this.socket = socket;
                this.ending = ending;
                this.giveUp = giveUp;
            }

            private static long NowMs()
            {
                return MonotonicClock.NowNs() / 1000000;
            }

            /// <summary>Run until the sensor has left; return false to connect again or to give up.</summary>
            public bool Run()
            {
                sendNext = spool.First;
                long lost = sendNext - spool.Acknowledged;
                heardMs = NowMs();
                Send(Start(sendNext, lost));
                while (!ended)
                {
                    if (!Listen()) throw new IOException("the bridge has closed the connection; connecting again");
                    if (window > 0 && lost > 0)
                    {
                        link.Lost += lost;
                        link.say(lost + " frames before frame " + sendNext + " are lost, and reported as lost");
                        spool.Acknowledge(sendNext);
                        lost = 0;
                    }
                    if (window > 0) link.lastSaid = "";
                    if (giveUp(spool.Acknowledged)) return false;
                    if (NowMs() - heardMs > DeadAfterMs) 
                        throw new IOException("the bridge does not answer; connecting again");
                    if (window > 0 && sendNext < spool.Next && sendNext < spool.Acknowledged + window)
                    {
                        var message = spool.Read(sendNext);
                        if (message != null)
                        {
                            Send(message);
                            sendNext++;
                            continue;
                        }
                        if (spool.Acknowledged >= sendNext) // those before the loss are stored: begin again behind it
                            return false;
                    }
                    else if (window > 0 && ending() && sendNext == spool.Next && !saidEnd)
                    {
                        Send(Encoding.ASCII.GetBytes("{\"say\":\"end\"}"));
                        saidEnd = true;
                    }
                    if (NowMs() - spokenMs > HereEveryMs && !saidEnd)
                        Send(Encoding.ASCII.GetBytes("{\"say\":\"here\"}"));
                    if (sendNext < spool.Next || saidEnd || ending()) Thread.Sleep(20);
                    else spool.WaitFor(sendNext, 20);
                }
                return true;
            }

            private byte[] Start(long first, long lost)
            {
                return Encoding.ASCII.GetBytes(string.Format(
                    CultureInfo.InvariantCulture,
                    "{{\"say\":\"start\",\"sensor\":\"{0}\",\"node_id\":{1},\"first\":{2},\"lost\":{3},"
                        + "\"next\":{4},\"now_ns\":{5}}}",
                    link.sensor, spool.NodeId, first, lost, spool.Next, spool.NowNs()));
            }

            private void Send(byte[] message)
            {
                var data = BodyMessage.Delimited(message);
                try
                {
                    for (int sent = 0; sent < data.Length;)
                        sent += socket.Send(data, sent, data.Length - sent, SocketFlags.None);
                }
                catch (SocketException)
                {
                    Listen(); // the reason, if the bridge has sent one
                    throw new IOException("the connection to the bridge ended; connecting again");
                }
                spokenMs = NowMs();
            }

            /// <summary>Read what the bridge has written; return false if it has closed the connection.</summary>
            private bool Listen()
            {
                var piece = new byte[4096];
                try
                {
                    while (socket.Poll(0, SelectMode.SelectRead))
                    {
                        int count = socket.Receive(piece);
                        if (count == 0) return ended;
                        heardMs = NowMs();
                        text.Append(Encoding.UTF8.GetString(piece, 0, count));
                        for (int at; (at = text.ToString().IndexOf('\n')) >= 0;)
                        {
                            string line = text.ToString(0, at);
                            text.Remove(0, at + 1);
                            Hear(line);
                        }
                    }
                }
                catch (SocketException)
                {
                    return false;
                }
                return true;
            }

            private void Hear(string line)
            {
                long number = 0;
                int space = line.IndexOf(' ');
                string word = space < 0 ? line : line.Substring(0, space);
                bool numbered = space > 0 && long.TryParse(
                    line.Substring(space + 1), NumberStyles.None, CultureInfo.InvariantCulture, out number);
                if (word == "kept" && numbered)
                    spool.Acknowledge(Math.Min(number, sendNext));
                else if (word == "window" && numbered)
                    window = number;
                else if (line == "ended")
                    ended = true;
                else
                {
                    link.Refusals++;
                    throw new IOException("the bridge says: " + line);
                }
            }
        }
    }
}
